"""ONNX Runtime sessions that obey a graph contract.

The rest of the runtime sees a network as a plain callable ``network(**arrays) -> dict of arrays``;
`OnnxGraph` is one, tests pass functions. This is the only module that knows ONNX Runtime.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy.typing as npt

from spotlight_runtime.errors import GraphContractError, ModelError, ProviderError
from spotlight_spec import GraphContract

if TYPE_CHECKING:
    import onnxruntime as ort

__all__ = ["Network", "OnnxGraph", "available_cpus", "open_graph"]

Network = Callable[..., dict[str, npt.NDArray[Any]]]
"""``network(**named_arrays)`` → named arrays, names as in the graph's contract."""

DEFAULT_PROVIDERS: Final = ("CPUExecutionProvider",)
_CGROUP: Final = Path("/sys/fs/cgroup")
_DTYPES: Final = {"float32": "tensor(float)", "int64": "tensor(int64)"}


def available_cpus(cgroup: Path = _CGROUP) -> int:
    """CPUs this process may use: its affinity, capped by the cgroup's quota.

    ONNX Runtime counts the host's cores, which inside a container oversubscribes the quota.
    """
    affinity = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    cpus = affinity or 1
    quota = _cgroup_quota(cgroup)
    return max(1, min(cpus, math.ceil(quota))) if quota else cpus


def _cgroup_quota(cgroup: Path) -> float | None:
    """Quota in CPUs from cgroup v2 (``cpu.max``) or v1, None where unlimited."""
    try:
        if (cgroup / "cpu.max").is_file():
            limit, period = (cgroup / "cpu.max").read_text().split()
        else:
            limit = (cgroup / "cpu/cpu.cfs_quota_us").read_text()
            period = (cgroup / "cpu/cpu.cfs_period_us").read_text()
        return int(limit) / int(period) if int(limit) > 0 else None
    except (OSError, ValueError):
        return None


class OnnxGraph:
    """A session behind its contract.

    Parameters
    ----------
    session : onnxruntime.InferenceSession
        Injected; see `open_graph`.
    contract : GraphContract
        Checked against the session's own inputs and outputs.

    Raises
    ------
    GraphContractError
        If names, element types or fixed dimensions differ.
    """

    def __init__(self, session: ort.InferenceSession, contract: GraphContract) -> None:
        self._session = session
        self._outputs = [tensor.name for tensor in contract.outputs]
        for expected, got in (
            (contract.inputs, session.get_inputs()),
            (contract.outputs, session.get_outputs()),
        ):
            _check_tensors(contract, expected, got)

    def __call__(self, **inputs: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        """Run the graph."""
        return dict(zip(self._outputs, self._session.run(self._outputs, inputs)))


def open_graph(
    folder: Path,
    contract: GraphContract,
    *,
    providers: Sequence[str] = DEFAULT_PROVIDERS,
    threads: int | None = None,
) -> OnnxGraph:
    """Open a graph of a model folder.

    Parameters
    ----------
    folder : Path
    contract : GraphContract
    providers : sequence of str
        ONNX Runtime execution providers in order of preference; the first must be the one in use.
    threads : int, optional
        Threads of one inference; by default the CPUs of the cgroup.

    Raises
    ------
    ProviderError
        If the first provider is not installed or did not take the graph.
    ModelError
        If ONNX Runtime refuses the file.
    GraphContractError
        If the graph is not what the contract says.
    """
    import onnxruntime as ort

    installed = ort.get_available_providers()
    if providers[0] not in installed:
        raise ProviderError(
            f"provider {providers[0]} is not installed; this onnxruntime has "
            f"{', '.join(installed)}. Install the matching onnxruntime build or choose one of them"
        )
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads or available_cpus()
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # A denormal costs up to 30 times a normal number and carries nothing a picture shows.
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    path = folder / contract.file_name
    try:
        session = ort.InferenceSession(str(path), options, providers=list(providers))
    except Exception as error:  # ONNX Runtime's exceptions share no base class
        raise ModelError(f"{path}: ONNX Runtime cannot load the graph: {error}") from error
    if session.get_providers()[0] != providers[0]:
        raise ProviderError(
            f"{path}: asked for {providers[0]}, in use is {session.get_providers()[0]}; "
            "name the provider you want to run on"
        )
    return OnnxGraph(session, contract)


def _check_tensors(contract: GraphContract, expected: Sequence[Any], got: Sequence[Any]) -> None:
    names, present = [t.name for t in expected], [t.name for t in got]
    if names != present:
        raise GraphContractError(
            f"{contract.file_name}: expected tensors {names}, got {present}; export the model again"
        )
    for want, have in zip(expected, got):
        fixed = [(a, b) for a, b in zip(want.shape, have.shape) if isinstance(a, int)]
        if (
            have.type != _DTYPES[want.dtype]
            or len(have.shape) != len(want.shape)
            or any(isinstance(b, int) and a != b for a, b in fixed)
        ):
            raise GraphContractError(
                f"{contract.file_name}: {want.name} should be {want.dtype} {want.shape}, is "
                f"{have.type} {tuple(have.shape)}; export the model again"
            )
