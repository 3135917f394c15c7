"""From a torch network to an ONNX graph that says exactly what its contract says."""

from __future__ import annotations

import re
from importlib.metadata import version
from pathlib import Path
from typing import Final

import onnx_ir as ir
import onnx_ir.passes.common as passes
import torch
from onnxscript.optimizer import fold_constants
from torch import nn
from torch.export import Dim

from spotlight_export.errors import TraceError
from spotlight_export.group_norm import lower_group_norms
from spotlight_export.quiet import quiet_libraries
from spotlight_spec import GraphContract, TensorSpec

__all__ = ["OPSET", "save_graph", "trace"]

OPSET: Final = 23
"""The newest operator set that ONNX Runtime 1.23 runs entirely on the CPU.

It keeps attention and GELU as one standard operator each where opset 18 spells them out; measured
speed is the same within noise, and a quantiser cannot touch attention's inner products by accident.
"""

EXTERNAL_DATA_ABOVE: Final = 64 << 20
"""Graphs with more bytes of weights than this keep them in ``<graph>.onnx.data``."""

WITHOUT_END: Final = 2**31 - 1
"""End of a slice that takes all there is, whichever size that may be."""

INLINE_BELOW: Final = 1024
"""Tensors smaller than this stay in the graph file: shape inference reads their values."""


def trace(
    network: nn.Module, example: tuple[torch.Tensor, ...], contract: GraphContract
) -> ir.Model:
    """Trace ``network`` into a graph with the names and dynamic dimensions of ``contract``.

    Parameters
    ----------
    network : Module
        Takes and returns the contract's tensors, in order.
    example : tuple of Tensor
        Inputs to trace with. No dynamic dimension may be 0 or 1 long, and no two that are
        unrelated equally long: torch would take the coincidence for a rule.
    contract : GraphContract

    Raises
    ------
    TraceError
        If torch cannot trace the network or the result does not match the contract.
    """
    shapes = tuple(_dynamic_dimensions(tensor.shape) for tensor in contract.inputs)
    try:
        with quiet_libraries(), torch.no_grad():
            exported = torch.export.export(
                _Positional(network.eval().requires_grad_(False)),
                (example,),
                dynamic_shapes=((shapes,)),
                strict=False,
            )
            program = torch.onnx.export(
                exported, (), dynamo=True, opset_version=OPSET, optimize=False, verbose=False
            )
    except Exception as error:
        raise TraceError(_explain(contract.name, error)) from error
    model = program.model
    _tidy(model)
    _apply_contract(model, contract)
    return model


def save_graph(model: ir.Model, path: Path) -> None:
    """Write a graph; weights are streamed tensor by tensor into external data where large.

    Parameters
    ----------
    model : Model
    path : Path
        ``<graph>.onnx``; external data goes beside it as ``<graph>.onnx.data``.
    """
    weights = sum(value.const_value.nbytes for value in model.graph.initializers.values())
    external = f"{path.name}.data" if weights > EXTERNAL_DATA_ABOVE else None
    ir.save(model, path, external_data=external, size_threshold_bytes=INLINE_BELOW)


class _Positional(nn.Module):
    """Hand the inputs over as one tuple, so that networks with ``*args`` trace like any other."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, inputs: tuple[torch.Tensor, ...]) -> object:
        return self.network(*inputs)


def _dynamic_dimensions(shape: tuple[int | str, ...]) -> dict[int, object]:
    return {axis: Dim.DYNAMIC for axis, size in enumerate(shape) if isinstance(size, str)}


def _tidy(model: ir.Model) -> None:
    """Fold what is constant and drop what only the trace needed.

    The pattern rewriter that ``optimize=True`` would run takes as long as the trace itself and
    gains nothing that ONNX Runtime does not do when it loads the graph.
    """
    fold_constants(model)
    passes.CommonSubexpressionEliminationPass()(model)
    _drop_whole_slices(model.graph)
    _fold_transposed_weights(model.graph)
    lower_group_norms(model.graph)
    passes.LiftConstantsToInitializersPass(lift_all_constants=False, size_limit=0)(model)
    passes.IdentityEliminationPass()(model)
    passes.RemoveUnusedNodesPass()(model)
    # The trace leaves file names in the metadata and shapes that disagree with ONNX's inference.
    passes.ClearMetadataAndDocStringPass()(model)
    model.metadata_props.clear()
    model.producer_name = "spotlight-export"
    model.producer_version = version("spotlight-relight")


def _drop_whole_slices(graph: ir.Graph) -> None:
    """Read a tensor itself where a slice takes all of it.

    ``x[:, a:b]`` is traced as two slices, of which the first is a copy of ``x``. A twelfth of the
    mini's condition encoder went into one.
    """
    for node in graph:
        if node.op_type != "Slice" or node.outputs[0].is_graph_output():
            continue
        starts, ends, *others = (ir.convenience.get_const_tensor(each) for each in node.inputs[1:])
        steps = others[1] if len(others) > 1 else None
        if starts is None or ends is None or (steps is None and len(others) > 1):
            continue
        whole = (
            (starts.numpy() == 0).all()
            and (ends.numpy() >= WITHOUT_END).all()
            and (steps is None or (steps.numpy() == 1).all())
        )
        if whole:
            ir.convenience.replace_all_uses_with(node.outputs[0], node.inputs[0])


def _fold_transposed_weights(graph: ir.Graph) -> None:
    """Store a linear layer's weight the way its MatMul reads it.

    The transposed copy is made when the tensor is written and dropped again, so folding costs one
    weight of memory, not one model.
    """
    for node in list(graph):
        if node.op_type != "Transpose" or not _is_weight(node.inputs[0]):
            continue
        weight, permutation = node.inputs[0].const_value, node.attributes["perm"].as_ints()
        name = f"{node.inputs[0].name}.transposed"
        if name not in graph.initializers:
            shape = [weight.shape[axis] for axis in permutation]
            graph.register_initializer(
                ir.val(
                    name,
                    dtype=weight.dtype,
                    shape=shape,
                    const_value=_transposed(weight, permutation, shape, name),
                )
            )
        ir.convenience.replace_all_uses_with(node.outputs[0], graph.initializers[name])


def _transposed(
    weight: ir.TensorProtocol, permutation: tuple[int, ...], shape: list[int], name: str
) -> ir.LazyTensor:
    def compute() -> ir.Tensor:
        return ir.tensor(weight.numpy().transpose(permutation).copy(), name=name)

    return ir.LazyTensor(compute, dtype=weight.dtype, shape=ir.Shape(shape), name=name)


def _is_weight(value: ir.Value | None) -> bool:
    return value is not None and value.is_initializer() and value.const_value is not None


def _apply_contract(model: ir.Model, contract: GraphContract) -> None:
    graph = model.graph
    for value in (output for node in graph for output in node.outputs):
        if not value.is_graph_output():
            value.shape = value.type = None
    for kind, values, tensors in (
        ("input", graph.inputs, contract.inputs),
        ("output", graph.outputs, contract.outputs),
    ):
        if len(values) != len(tensors):
            raise TraceError(
                f"{contract.name}: the trace has {len(values)} {kind}s, the contract "
                f"{len(tensors)} ({', '.join(t.name for t in tensors)}); the network and its "
                "contract disagree"
            )
        for value, tensor in zip(values, tensors):
            _check_dimensions(contract.name, value, tensor)
            value.name = tensor.name
            value.shape = ir.Shape(tensor.shape)
            value.type = ir.TensorType(
                ir.DataType[tensor.dtype.replace("float32", "float").upper()]
            )
    passes.NameFixPass()(model)


def _check_dimensions(graph: str, value: ir.Value, tensor: TensorSpec) -> None:
    """A dynamic dimension that came out as a number was baked in by the trace."""
    for axis, (size, wanted) in enumerate(zip(value.shape, tensor.shape, strict=True)):
        traced = size if isinstance(size, int) else None
        if traced != (wanted if isinstance(wanted, int) else None):
            raise TraceError(
                f"{graph}: dimension {axis} of {tensor.name!r} was traced as "
                f"{traced or 'dynamic'}, the contract says {wanted!r}; the checkpoint's channels "
                "differ from the backbone's, or torch specialised the dimension"
            )


def _explain(graph: str, error: Exception) -> str:
    """Name the node a trace failed at, as far as torch tells."""
    chain: list[BaseException] = [error]
    while (cause := chain[-1].__cause__) is not None:
        chain.append(cause)
    text = "\n".join(str(link) for link in chain)
    node = re.search(r"node[: ]+'?%?([\w.]+)", text)
    where = f"at node {node.group(1)!r}" if node else "before any node was translated"
    reason = str(chain[-1]).strip().splitlines() or [type(chain[-1]).__name__]
    return (
        f"{graph}: tracing failed {where}: {reason[0]}. If the checkpoint is a Stable Diffusion "
        "variant with other blocks, export its plain UNet2DConditionModel; otherwise install the "
        f"versions this exporter was tested with (torch 2.13, onnxscript 0.7; here torch "
        f"{torch.__version__}, onnxscript {version('onnxscript')})"
    )
