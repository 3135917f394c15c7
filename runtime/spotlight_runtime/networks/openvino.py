"""The same graphs on OpenVINO, which computes in bfloat16 where the processor can.

An optional engine (extra ``openvino``): where a processor multiplies bfloat16 (AMX, AVX-512 BF16) a
full-size evaluation takes less than two thirds of ONNX Runtime's int8 (``bench/peers.md``). Beside
`spotlight_runtime.networks.sessions` the only module that knows an engine.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from spotlight_runtime.errors import MissingExtraError, ModelError
from spotlight_runtime.networks.sessions import check_tensors, usable_threads
from spotlight_spec import GraphContract

if TYPE_CHECKING:
    import openvino as ov

__all__ = ["OpenVinoGraph", "OpenVinoPrecision", "open_graph"]

OpenVinoPrecision = Literal["f32", "bf16"]
_DTYPES: Final = {"f32": "float32", "i64": "int64"}


class OpenVinoGraph:
    """A compiled model behind its contract.

    Parameters
    ----------
    compiled : openvino.CompiledModel
        Injected; see `open_graph`.
    contract : GraphContract
    """

    def __init__(self, compiled: ov.CompiledModel, contract: GraphContract) -> None:
        self._compiled = compiled
        self._name = contract.file_name
        self._outputs = [tensor.name for tensor in contract.outputs]

    def __call__(self, **inputs: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        """Run the graph.

        Raises
        ------
        ModelError
            If OpenVINO cannot run it on these inputs.
        """
        try:
            # A request of its own: callers in several threads do not share buffers.
            found = self._compiled.create_infer_request().infer(inputs)
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
) -> OpenVinoGraph:
    """Compile a graph of a model folder.

    Parameters
    ----------
    folder : Path
    contract : GraphContract
    precision : {"f32", "bf16"}
        Of the arithmetic; weights are the model's. Without bfloat16 in the processor OpenVINO
        computes in float32 all the same.
    threads : int, optional
        Threads of one inference; by default the CPUs of the cgroup.

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
    settings = {
        "INFERENCE_PRECISION_HINT": precision,
        "INFERENCE_NUM_THREADS": usable_threads(threads),
        "PERFORMANCE_HINT": "LATENCY",
    }
    path = folder / contract.file_name
    try:
        compiled = ov.Core().compile_model(str(path), "CPU", settings)
    except RuntimeError as error:
        raise ModelError(f"{path}: OpenVINO cannot load the graph: {error}") from error
    for expected, ports in (
        (contract.inputs, compiled.inputs),
        (contract.outputs, compiled.outputs),
    ):
        check_tensors(contract, expected, [_described(port) for port in ports])
    return OpenVinoGraph(compiled, contract)


def _described(port: Any) -> tuple[str, str, tuple[int | None, ...]]:
    """Name, element type and sizes of an input or output."""
    dtype = port.element_type.get_type_name()
    sizes = (None if size.is_dynamic else size.get_length() for size in port.partial_shape)
    return port.any_name, _DTYPES.get(dtype, dtype), tuple(sizes)
