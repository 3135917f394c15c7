"""Static int8: convolutions and linear layers on 256 levels, the rest in float32.

Written as quantise/dequantise pairs (QDQ), which ONNX Runtime turns into its integer kernels, and
with ONNX Runtime's own fused self-attention. Weights are signed and symmetric with one scale per
output channel; activations are unsigned with one scale a tensor, from the range they had in real
runs.

What stays float32, and why:

* attention's products and softmax, normalisations, activations: little work, much precision;
* layers with a side of the latent's few channels (first and last convolution): next to no work,
  and their error reaches the image unattenuated;
* the time embedding's layers: one row of work a step, and every residual block depends on them.

A convolution's result is quantised too, or ONNX Runtime would run it in float; a linear layer's
result is not, since its integer kernel returns float.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import onnx_ir as ir

from spotlight_export.attention import fuse_self_attention
from spotlight_export.errors import QuantisationError
from spotlight_export.tracing import save_graph

__all__ = ["Range", "quantise_graph", "tensors_to_observe"]

MIN_CHANNELS: Final = 16
"""Layers with fewer channels on either side stay float32."""

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Layer:
    """A node to quantise, and the axis of its weight that counts output channels."""

    node: ir.Node
    channel_axis: int

    @property
    def weight(self) -> ir.Value:
        value = self.node.inputs[1]
        assert value is not None
        return value


def tensors_to_observe(model: ir.Model) -> list[str]:
    """Names of the activations whose ranges `quantise_graph` needs."""
    return list(_observed(list(_layers(model.graph))))


def quantise_graph(source: Path, target: Path, ranges: dict[str, Range]) -> int:
    """Quantise a float32 graph file.

    Weights are read, quantised and written one at a time, so memory does not grow with the model.

    Parameters
    ----------
    source, target : Path
        Graph files in different folders.
    ranges : dict of (float, float)
        Smallest and largest value of each tensor of `tensors_to_observe`.

    Returns
    -------
    int
        Number of layers quantised.

    Raises
    ------
    QuantisationError
        If the graph has nothing to quantise, or a range is missing or not finite.
    """
    model = ir.load(source)
    graph = model.graph
    layers = list(_layers(graph))
    if not layers:
        raise QuantisationError(
            f"{source.name}: no convolution or linear layer with constant weights of at least "
            f"{MIN_CHANNELS} channels; export it with --precision fp32"
        )
    fuse_self_attention(model)
    pairs = {name: _add_pair(graph, value, ranges) for name, value in _observed(layers).items()}
    for layer in layers:
        node = layer.node
        _, activation, scale = pairs[_name(node.inputs[0])]
        weight_scales = _quantise_weight(graph, layer)
        if len(node.inputs) > 2 and node.inputs[2] is not None:
            _quantise_bias(graph, node, scale * weight_scales)
        node.replace_input_with(0, activation)
    for layer in layers:
        if layer.node.op_type == "Conv":
            _use_quantised(graph, layer.node.outputs[0], *pairs[_name(layer.node.outputs[0])][:2])
    for value in list(graph.initializers.values()):
        if not value.uses():
            del graph.initializers[_name(value)]
    save_graph(model, target)
    return len(layers)


def _layers(graph: ir.Graph) -> list[_Layer]:
    layers = []
    for node in graph:
        if node.op_type == "Conv":
            axis, sides = 0, 2
        elif node.op_type == "MatMul":
            axis, sides = 1, 2
        else:
            continue
        weight = node.inputs[1]
        if weight is None or weight.const_value is None or not weight.is_initializer():
            continue
        shape = weight.const_value.shape.numpy()
        if len(shape) >= sides and min(shape[:sides]) >= MIN_CHANNELS:
            layers.append(_Layer(node, axis))
    return layers


def _observed(layers: list[_Layer]) -> dict[str, ir.Value]:
    """Activations to quantise: every layer's input and every convolution's result."""
    values = [layer.node.inputs[0] for layer in layers]
    values += [layer.node.outputs[0] for layer in layers if layer.node.op_type == "Conv"]
    return {_name(value): value for value in values}


def _name(value: ir.Value | None) -> str:
    assert value is not None
    return str(value.name)


def _scale_and_zero(name: str, ranges: dict[str, Range]) -> tuple[np.float32, np.uint8]:
    """Map a range, widened to hold zero exactly, onto 0..255."""
    low, high = ranges.get(name, (np.nan, np.nan))
    if not (np.isfinite(low) and np.isfinite(high)):
        raise QuantisationError(
            f"tensor {name!r} has range ({low}, {high}) in the calibration runs, expected finite "
            "numbers; the weights overflow, export with --precision fp32"
        )
    low, high = min(low, 0.0), max(high, 0.0)
    scale = np.float32(max(high - low, 1e-8) / 255)
    return scale, np.uint8(np.clip(np.round(-low / scale), 0, 255))


def _constant(graph: ir.Graph, name: str, array: npt.NDArray[Any] | np.generic) -> ir.Value:
    tensor = ir.tensor(np.asarray(array), name=name)
    value = ir.val(name, dtype=tensor.dtype, shape=list(tensor.shape), const_value=tensor)
    graph.register_initializer(value)
    return value


def _add_pair(
    graph: ir.Graph, value: ir.Value, ranges: dict[str, Range]
) -> tuple[ir.Node, ir.Value, float]:
    """Quantise and dequantise a tensor where it is made; nobody uses the result yet.

    Returns
    -------
    quantise : Node
    dequantised : Value
    scale : float
    """
    name = _name(value)
    scale, zero = _scale_and_zero(name, ranges)
    parameters = [_constant(graph, f"{name}.scale", scale), _constant(graph, f"{name}.zero", zero)]
    quantise = ir.node("QuantizeLinear", [value, *parameters], name=f"{name}.quantise")
    quantise.outputs[0].name = f"{name}.quantised"
    dequantise = ir.node(
        "DequantizeLinear", [quantise.outputs[0], *parameters], name=f"{name}.dequantise"
    )
    dequantise.outputs[0].name = f"{name}.dequantised"
    if (producer := value.producer()) is not None:
        graph.insert_after(producer, [quantise, dequantise])
    else:
        graph.insert_before(graph[0], [quantise, dequantise])
    return quantise, dequantise.outputs[0], float(scale)


def _use_quantised(
    graph: ir.Graph, result: ir.Value, quantise: ir.Node, dequantised: ir.Value
) -> None:
    """Let everybody but ``quantise`` read the round-tripped result, the graph's caller included."""
    for user, index in list(result.uses()):
        if user is not quantise:
            user.replace_input_with(index, dequantised)
    for index, output in enumerate(graph.outputs):
        if output is result:
            dequantised.type, dequantised.shape = result.type, result.shape
            graph.outputs[index] = dequantised
            result.name, dequantised.name = f"{result.name}.exact", result.name


def _quantise_weight(graph: ir.Graph, layer: _Layer) -> npt.NDArray[np.float32]:
    """Replace a layer's weight by int8 and a dequantisation; return the scale of each channel."""
    value, axis = layer.weight, layer.channel_axis
    tensor, name = value.const_value, _name(value)
    assert tensor is not None
    array = tensor.numpy()
    others = tuple(i for i in range(array.ndim) if i != axis)
    scales: npt.NDArray[np.float32] = np.abs(array).max(axis=others) / np.float32(127)
    scales[scales == 0] = 1.0  # a channel of zeros
    broadcast = np.expand_dims(scales, others)

    def quantised() -> ir.Tensor:
        return ir.tensor(np.round(tensor.numpy() / broadcast).astype(np.int8), name=f"{name}.int8")

    stored = ir.val(
        f"{name}.int8",
        dtype=ir.DataType.INT8,
        shape=list(array.shape),
        const_value=ir.LazyTensor(
            quantised, dtype=ir.DataType.INT8, shape=tensor.shape, name=f"{name}.int8"
        ),
    )
    graph.register_initializer(stored)
    zeros = np.zeros(scales.shape, np.int8)
    _dequantise(graph, layer.node, 1, stored, (scales, zeros), axis)
    return scales


def _quantise_bias(graph: ir.Graph, node: ir.Node, scales: npt.NDArray[np.float32]) -> None:
    bias = node.inputs[2]
    assert bias is not None
    assert bias.const_value is not None
    levels = np.round(bias.const_value.numpy() / scales).clip(-(2**31), 2**31 - 1)
    stored = _constant(graph, f"{node.name}.bias.int32", levels.astype(np.int32))
    zeros = np.zeros(scales.shape, np.int32)
    _dequantise(graph, node, 2, stored, (scales.astype(np.float32), zeros), 0)


def _dequantise(
    graph: ir.Graph,
    node: ir.Node,
    index: int,
    stored: ir.Value,
    parameters: tuple[npt.NDArray[Any], npt.NDArray[Any]],
    axis: int,
) -> None:
    name = f"{node.name}.{index}"
    scale, zero = (
        _constant(graph, f"{name}.{what}", array)
        for what, array in zip(("scale", "zero"), parameters)
    )
    dequantise = ir.node(
        "DequantizeLinear", [stored, scale, zero], {"axis": axis}, name=f"{name}.dequantise"
    )
    dequantise.outputs[0].name = f"{name}.dequantised"
    graph.insert_before(node, dequantise)
    node.replace_input_with(index, dequantise.outputs[0])
