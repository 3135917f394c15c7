"""Half precision as a storage format: weights on disk in float16, arithmetic in float32.

CPUs gain nothing from half arithmetic and attention overflows in it, but half the file is half the
file. Each weight is followed by a Cast that ONNX Runtime folds away when it loads the graph.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import onnx_ir as ir

__all__ = ["store_weights_as_half"]

LARGEST_HALF: Final = 65504.0

LOSS_BOUND: Final = 1e-3
"""Relative L2 error above which a weight stays float32.

Rounding to 11 bits costs 2⁻¹² ≈ 3e-4 in the mean; only a tensor with many values below half's
smallest normal number, 6e-5, exceeds this.
"""


def store_weights_as_half(model: ir.Model) -> list[str]:
    """Replace float32 weights by float16 ones with a cast behind them, in place.

    Vectors (biases, norms, scales), of whatever rank, and tables (the sines of timesteps) stay
    float32: they are small and everything passes them.

    Parameters
    ----------
    model : Model

    Returns
    -------
    list of str
        The weights that had to stay float32, each with the reason.
    """
    graph, kept = model.graph, []
    first = graph[0]
    for value in list(graph.initializers.values()):
        weight = value.const_value
        if weight is None or weight.dtype != ir.DataType.FLOAT or _is_small(value):
            continue
        if reason := _unfit(weight.numpy()):
            kept.append(f"{value.name}: {reason}")
            continue
        half = ir.val(
            f"{value.name}.half",
            dtype=ir.DataType.FLOAT16,
            shape=list(weight.shape),
            const_value=_as_half(weight, f"{value.name}.half"),
        )
        cast = ir.node("Cast", [half], {"to": ir.DataType.FLOAT}, name=f"{value.name}.cast")
        cast.outputs[0].name = f"{value.name}.float"
        graph.insert_before(first, cast)
        ir.convenience.replace_all_uses_with(value, cast.outputs[0])
        del graph.initializers[value.name]
        graph.register_initializer(half)
    return kept


def _is_small(value: ir.Value) -> bool:
    """Whether it is a vector, or a table to look things up in."""
    weight = value.const_value
    vector = weight is not None and weight.size == max(weight.shape, default=1)
    return vector or any(node.op_type == "Gather" for node in value.consumers())


def _unfit(weight: np.ndarray) -> str | None:
    """Why a weight cannot be stored as half, None where it can."""
    largest = float(np.abs(weight).max(initial=0.0))
    if largest > LARGEST_HALF:
        return f"largest value {largest:.3g} overflows"
    exact = weight.astype(np.float32, copy=False)
    norm = float(np.linalg.norm(exact))
    error = float(np.linalg.norm(exact - exact.astype(np.float16).astype(np.float32)))
    if error > LOSS_BOUND * norm:
        return f"relative error {error / norm:.2g} exceeds {LOSS_BOUND:g}"
    return None


def _as_half(weight: ir.TensorProtocol, name: str) -> ir.LazyTensor:
    def convert() -> ir.Tensor:
        return ir.tensor(weight.numpy().astype(np.float16), name=name)

    return ir.LazyTensor(convert, dtype=ir.DataType.FLOAT16, shape=weight.shape, name=name)
