"""The same graphs on OpenVINO, which computes in bfloat16 where the processor can.

An optional engine (extra ``openvino``): where a processor multiplies bfloat16 (AMX, AVX-512 BF16) a
full-size evaluation takes less than two thirds of ONNX Runtime's int8 (``bench/peers.md``). Beside
`spotlight_runtime.networks.sessions` the only module that opens an engine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from spotlight_runtime.errors import MissingExtraError, ModelError
from spotlight_runtime.networks.openvino_fold import fold_upsampling
from spotlight_runtime.networks.sessions import check_tensors, usable_threads
from spotlight_spec import GraphContract

if TYPE_CHECKING:
    import openvino as ov

__all__ = ["OpenVinoGraph", "OpenVinoPrecision", "computes_indices", "open_graph"]

OpenVinoPrecision = Literal["f32", "bf16"]
_DTYPES: Final = {"f32": "float32", "i64": "int64"}


class OpenVinoGraph:
    """A graph behind its contract, compiled when it is first run.

    Compiled for a single size it is some 6 % quicker than for any (its upsampling can be folded,
    too: `fold_upsampling`), so it is compiled once for the size it is meant for and once for all
    others, each where it is asked for: what a size gives does not depend on what was asked before.

    Parameters
    ----------
    compiled : callable
        ``compiled(own)`` → the model, for the size it is meant for or for any; see `open_graph`.
    contract : GraphContract
    own : dict of tuple of int
        Shapes of the inputs at that size; empty where it is not known.
    """

    def __init__(
        self,
        compiled: Callable[[bool], ov.CompiledModel],
        contract: GraphContract,
        own: Mapping[str, tuple[int, ...]],
    ) -> None:
        self._compiled, self._lock, self._own = cache(compiled), Lock(), dict(own)
        self._name = contract.file_name
        self._outputs = [tensor.name for tensor in contract.outputs]

    def __call__(self, **inputs: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        """Run the graph.

        Raises
        ------
        ModelError
            If OpenVINO cannot run it on these inputs.
        """
        own = {name: value.shape for name, value in inputs.items()} == self._own
        try:
            with self._lock:
                compiled = self._compiled(own)
            # A request of its own: callers in several threads do not share buffers.
            found = compiled.create_infer_request().infer(inputs)
            return {name: np.array(found[name], np.float32) for name in self._outputs}
        except (RuntimeError, TypeError, ValueError) as error:
            shapes = ", ".join(f"{k} {v.dtype}{list(v.shape)}" for k, v in inputs.items())
            raise ModelError(f"{self._name}: cannot be run on {shapes}: {error}") from error


def open_graph(
    folder: Path,
    contract: GraphContract,
    *,
    precision: OpenVinoPrecision,
    threads: int | None = None,
    sizes: Mapping[str, int] | None = None,
) -> OpenVinoGraph:
    """Open a graph of a model folder.

    Parameters
    ----------
    folder : Path
    contract : GraphContract
    precision : {"f32", "bf16"}
        Of the arithmetic; weights are the model's. Without bfloat16 in the processor OpenVINO
        computes in float32 all the same, as it does where a graph works out places to read at
        (`computes_indices`).
    threads : int, optional
        Threads of one inference; by default the CPUs of the cgroup.
    sizes : dict of int, optional
        Of the contract's dynamic dimensions, by name: the size the graph is meant for.

    Raises
    ------
    MissingExtraError
        If OpenVINO is not installed.
    InvalidInputError
        If ``threads`` is less than 1.
    ModelError
        If OpenVINO refuses the file.
    GraphContractError
        If the graph is not what the contract says.
    """
    try:
        import openvino as ov
    except ImportError as error:
        raise MissingExtraError(
            "engine openvino: OpenVINO is not installed; pip install 'spotlight-relight[openvino]'"
        ) from error
    path = folder / contract.file_name
    core = ov.Core()
    try:
        model = core.read_model(str(path))
    except RuntimeError as error:
        raise ModelError(f"{path}: OpenVINO cannot load the graph: {error}") from error
    for expected, ports in ((contract.inputs, model.inputs), (contract.outputs, model.outputs)):
        check_tensors(contract, expected, [_described(port) for port in ports])
    settings = {
        "INFERENCE_PRECISION_HINT": "f32" if computes_indices(model) else precision,
        "INFERENCE_NUM_THREADS": usable_threads(threads),
        "PERFORMANCE_HINT": "LATENCY",
    }
    own = _shapes(contract, sizes or {})

    def compiled(at_own: bool) -> ov.CompiledModel:
        if not at_own:
            return core.compile_model(model, "CPU", settings)
        still = model.clone()
        still.reshape({name: list(shape) for name, shape in own.items()})
        fold_upsampling(still)
        return core.compile_model(still, "CPU", settings)

    return OpenVinoGraph(compiled, contract, own)


def computes_indices(model: ov.Model) -> bool:
    """Whether a graph gathers at places that it works out with floating-point numbers.

    Bfloat16 counts to 256: from there on its neighbour is read instead, or what lies outside. The
    mini's condition encoder does, which runs once a branch and costs little in float32, too.
    """
    return any(
        _was_floating(node.input_value(1))
        for node in model.get_ops()
        if node.get_type_name().startswith("Gather")
    )


def _was_floating(value: Any) -> bool:
    """Whether integers come of floating-point numbers; an array's shape does not."""
    if value.get_element_type().is_real():
        return True
    node = value.get_node()
    sources = [] if node.get_type_name() == "ShapeOf" else node.input_values()
    return any(_was_floating(source) for source in sources)


def _shapes(contract: GraphContract, sizes: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Shapes of the inputs; empty where a dimension is not among the sizes."""
    found = {
        tensor.name: tuple(d if isinstance(d, int) else sizes.get(d, 0) for d in tensor.shape)
        for tensor in contract.inputs
    }
    return found if all(all(shape) for shape in found.values()) else {}


def _described(port: Any) -> tuple[str, str, tuple[int | None, ...]]:
    """Name, element type and sizes of an input or output."""
    dtype = port.element_type.get_type_name()
    sizes = (None if size.is_dynamic else size.get_length() for size in port.partial_shape)
    return port.any_name, _DTYPES.get(dtype, dtype), tuple(sizes)
