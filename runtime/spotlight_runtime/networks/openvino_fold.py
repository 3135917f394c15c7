"""Doubling an image and convolving it, as one transposed convolution: for OpenVINO.

A 3×3 convolution of pixels that were each repeated 2×2 meets every source pixel up to four times.
Adding its weights up beforehand leaves four products of nine, the same sum in real arithmetic. Only
whole repetitions can be folded: where an odd size is cropped from them, the last row and column
meet the border before their pixel's second half.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from spotlight_runtime.arrays import FloatArray

if TYPE_CHECKING:
    import openvino as ov

__all__ = ["fold_upsampling"]

_DOUBLING: Final = {
    "mode": "nearest",
    "coordinate_transformation_mode": "asymmetric",
    "nearest_mode": "floor",
}
_CONVOLVING: Final = {
    "strides": [1, 1],
    "dilations": [1, 1],
    "pads_begin": [1, 1],
    "pads_end": [1, 1],
}


def fold_upsampling(model: ov.Model) -> int:
    """Replace every doubling and 3×3 convolution after it by a transposed convolution.

    Parameters
    ----------
    model : openvino.Model
        Of static shapes; changed in place.

    Returns
    -------
    int
        How many there were. What has another size, another kernel or weights that are computed (an
        integer graph's) stays as it is.
    """
    from openvino import opset13 as ops

    found = list(_doubled(model))
    for convolution, weights, small in found:
        kernel = ops.constant(_whole_kernel(weights))
        transposed = ops.convolution_backprop_data(
            small, kernel, [2, 2], pads_begin=[1, 1], pads_end=[1, 1]
        )
        convolution.output(0).replace(transposed.output(0))
    model.validate_nodes_and_infer_types()
    return len(found)


def _doubled(model: ov.Model) -> Iterator[tuple[Any, FloatArray, Any]]:
    """Convolutions of doubled images, each with its weights and what was doubled."""
    for node in model.get_ordered_ops():
        if node.get_type_name() != "Convolution" or not _has(node, _CONVOLVING):
            continue
        source = node.input_value(0)
        while source.get_node().get_type_name() == "Slice":
            source = source.get_node().input_value(0)
        resize = source.get_node()
        if resize.get_type_name() != "Interpolate" or not _has(resize, _DOUBLING):
            continue
        small = resize.input_value(0)
        doubled = [*small.shape[:2], *(2 * side for side in small.shape[2:])]
        weights = _weights(node)
        # Of the doubled image's shape nothing was cropped on the way.
        if list(node.input_value(0).shape) == doubled and weights is not None:
            yield node, weights, small


def _has(node: Any, wanted: dict[str, Any]) -> bool:
    attributes = node.get_attributes()
    return all(attributes.get(name) == value for name, value in wanted.items())


def _weights(convolution: Any) -> FloatArray | None:
    """3×3 weights that are stored, in whatever floating-point precision."""
    node = convolution.input_value(1).get_node()
    if node.get_type_name() == "Convert":
        node = node.input_value(0).get_node()
    stored = node.get_type_name() == "Constant" and node.get_element_type().is_real()
    if not stored or list(node.shape[2:]) != [3, 3]:
        return None
    return np.asarray(node.data, np.float32)


def _whole_kernel(weights: FloatArray) -> FloatArray:
    """Transposed 4×4 kernel (I, O, 4, 4): the 3×3 one (O, I, 3, 3) over the 2×2 repetition."""
    whole = np.zeros((*weights.shape[:2], 4, 4), np.float32)
    for row in (0, 1):
        for column in (0, 1):
            whole[:, :, row : row + 3, column : column + 3] += weights
    return np.ascontiguousarray(whole.transpose(1, 0, 2, 3)[..., ::-1, ::-1])
