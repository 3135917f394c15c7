"""ONNX Runtime sessions that obey a graph contract.

The rest of the runtime sees a network as a plain callable ``network(**arrays) -> dict of arrays``;
`OnnxGraph` is one, tests pass functions. This is the only module that knows ONNX Runtime.
"""

from __future__ import annotations

import ctypes
import math
import os
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy.typing as npt

from spotlight_runtime.errors import (
    GraphContractError,
    InvalidInputError,
    ModelError,
    ProviderError,
)
from spotlight_spec import GraphContract, TensorSpec

if TYPE_CHECKING:
    import onnxruntime as ort

__all__ = [
    "Network",
    "OnnxGraph",
    "available_cpus",
    "check_providers",
    "check_tensors",
    "open_graph",
    "runtime_version",
    "usable_threads",
]

Network = Callable[..., dict[str, npt.NDArray[Any]]]
"""``network(**named_arrays)`` → named arrays, names as in the graph's contract."""

DEFAULT_PROVIDERS: Final = ("CPUExecutionProvider",)
EVERY_STEP: Final = ("denoiser", "denoiser_shallow", "controlnet", "unet")
"""Graphs that run every step and keep their working memory; the others give it back. A block kept
by an arena and given back after each run is mapped anew for the next, which nearly doubled the
time of a condition encoder; from the C library, small tensors come warm and large ones go back."""
_CGROUP: Final = Path("/sys/fs/cgroup")
_DTYPES: Final = {"tensor(float)": "float32", "tensor(int64)": "int64"}


def available_cpus(cgroup: Path = _CGROUP) -> int:
    """CPUs this process may use: its affinity, capped by the cgroup's quota.

    ONNX Runtime counts the host's cores, which inside a container oversubscribes the quota.
    """
    affinity = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    cpus = affinity or 1
    quota = _cgroup_quota(cgroup)
    return max(1, min(cpus, math.ceil(quota))) if quota else cpus


def usable_threads(wanted: int | None) -> int:
    """So many threads, or by default `available_cpus`.

    Raises
    ------
    InvalidInputError
        If fewer than one are wanted.
    """
    if wanted is not None and wanted < 1:
        raise InvalidInputError(f"threads: expected 1 or more, got {wanted}")
    return wanted or available_cpus()


def runtime_version() -> str:
    """ONNX Runtime's, whichever of its distributions (for CPUs, for GPUs) is installed."""
    import onnxruntime as ort

    return str(ort.__version__)


def check_providers(providers: Sequence[str]) -> None:
    """Raise unless execution providers can be asked for.

    Raises
    ------
    InvalidInputError
        If they are no list of names, or there is none.
    ProviderError
        If the first, which must be the one in use, is not installed.
    """
    import onnxruntime as ort

    if isinstance(providers, str) or not providers:
        raise InvalidInputError(
            "providers: expected a list of ONNX Runtime's execution providers, say "
            f"{list(DEFAULT_PROVIDERS)}, got {providers!r}"
        )
    installed = ort.get_available_providers()
    if providers[0] not in installed:
        raise ProviderError(
            f"provider {providers[0]} is not installed; this onnxruntime has "
            f"{', '.join(installed)}. Install the matching onnxruntime build or choose one of them"
        )


def _cgroup_quota(cgroup: Path) -> float | None:
    """Quota in CPUs from cgroup v2 (``cpu.max``) or v1, None where unlimited."""
    try:
        if (cgroup / "cpu.max").is_file():
            limit, period = (cgroup / "cpu.max").read_text().split()
        else:
            limit = (cgroup / "cpu/cpu.cfs_quota_us").read_text()
            period = (cgroup / "cpu/cpu.cfs_period_us").read_text()
        return int(limit) / int(period) if int(limit) > 0 else None
    except (OSError, ValueError, ZeroDivisionError):
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
        If names, element types or dimensions differ, or a dynamic dimension is fixed.
    """

    def __init__(self, session: ort.InferenceSession, contract: GraphContract) -> None:
        self._session = session
        self._name = contract.file_name
        self._outputs = [tensor.name for tensor in contract.outputs]
        for expected, got in (
            (contract.inputs, session.get_inputs()),
            (contract.outputs, session.get_outputs()),
        ):
            found = [(t.name, _DTYPES.get(t.type, t.type), tuple(t.shape)) for t in got]
            check_tensors(contract, expected, found)

    def __call__(self, **inputs: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        """Run the graph.

        Raises
        ------
        ModelError
            If ONNX Runtime cannot run it on these inputs.
        """
        try:
            with _denormals_as_zero():
                return dict(zip(self._outputs, self._session.run(self._outputs, inputs)))
        except Exception as error:  # ONNX Runtime's exceptions share no base class
            shapes = ", ".join(f"{k} {v.dtype}{list(v.shape)}" for k, v in inputs.items())
            raise ModelError(f"{self._name}: cannot be run on {shapes}: {error}") from error


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
    InvalidInputError
        If ``threads`` is less than 1, or no provider is named.
    ProviderError
        If the first provider is not installed or did not take the graph.
    ModelError
        If ONNX Runtime refuses the file.
    GraphContractError
        If the graph is not what the contract says.
    """
    import onnxruntime as ort

    check_providers(providers)
    options = ort.SessionOptions()
    options.intra_op_num_threads = usable_threads(threads)
    options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = contract.name in EVERY_STEP
    options.log_severity_level = 4  # what fails is raised, and need not be printed as well
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    # Threads that wait for more work keep the cores from the graph that runs next.
    options.add_session_config_entry("session.force_spinning_stop", "1")
    # Without VNNI, unsigned times signed bytes are added in 16 bits that saturate: a third of a
    # layer's result can be missing. Unsigned weights are slower there, but exact.
    options.add_session_config_entry("session.x64quantprecision", "1")
    path = folder / contract.file_name
    try:
        session = _open_apart(
            lambda: ort.InferenceSession(str(path), options, providers=list(providers))
        )
    except Exception as error:  # ONNX Runtime's exceptions share no base class
        raise ModelError(f"{path}: ONNX Runtime cannot load the graph: {error}") from error
    if session.get_providers()[0] != providers[0]:
        raise ProviderError(
            f"{path}: asked for {providers[0]}, in use is {session.get_providers()[0]}; "
            "name the provider you want to run on"
        )
    return OnnxGraph(session, contract)


# A denormal costs up to 30 times a normal number and carries nothing a picture shows. ONNX Runtime
# turns them to zero in its own threads, and in the thread that opens the process's first session,
# where it leaves the processor in that mode: Python's and numpy's floats would lose their denormals
# too. So sessions are opened in a thread of their own, and the calling thread, which does its share
# of the work, is put into that mode for the span of a run only.
_FENV_BYTES: Final = 256  # more than any fenv_t
_FLUSH_BITS: Final = {"x86_64": (28, 0x8040), "aarch64": (0, 1 << 24)}
"""Where in Linux's fenv_t the control word lies, and its bits (MXCSR's FTZ and DAZ; FPCR's FZ)."""


def _open_apart(make: Callable[[], ort.InferenceSession]) -> ort.InferenceSession:
    """Open a session in a short-lived thread, which keeps the mode it is left in to itself."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        session = pool.submit(make).result()
    _trim_heap()
    return session


def _trim_heap() -> None:
    """Give back what opening a session leaves behind, twice the size of its weights with glibc."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)


@contextmanager
def _denormals_as_zero() -> Iterator[None]:
    """Flush denormals in this thread until the block ends."""
    c_library = _c_library()
    if c_library is None:
        yield
        return
    before = ctypes.create_string_buffer(_FENV_BYTES)
    c_library.fegetenv(before)
    offset, bits = _FLUSH_BITS[platform.machine()]
    flushing = ctypes.create_string_buffer(before.raw)
    ctypes.c_uint32.from_buffer(flushing, offset).value |= bits
    c_library.fesetenv(flushing)
    try:
        yield
    finally:
        c_library.fesetenv(before)


@cache
def _c_library() -> ctypes.CDLL | None:
    """The C library with C99's floating-point environment, where its layout is known."""
    if sys.platform != "linux" or platform.machine() not in _FLUSH_BITS:
        return None
    try:
        library = ctypes.CDLL(None)
        return library if library.fegetenv and library.fesetenv else None
    except (AttributeError, OSError):
        return None


def check_tensors(
    contract: GraphContract,
    expected: Sequence[TensorSpec],
    present: Sequence[tuple[str, str, tuple[int | str | None, ...]]],
) -> None:
    """Hold an engine's tensors against a contract's.

    Parameters
    ----------
    contract : GraphContract
    expected : sequence of TensorSpec
        Its inputs or its outputs.
    present : sequence of (str, str, tuple)
        Names, element types and sizes that the engine says; no number where a size is free.

    Raises
    ------
    GraphContractError
    """
    names, found = [t.name for t in expected], [name for name, _, _ in present]
    if names != found:
        raise GraphContractError(
            f"{contract.file_name}: expected tensors {names}, got {found}; export the model again"
        )
    for want, (_, dtype, shape) in zip(expected, present):
        if (
            dtype != want.dtype
            or len(shape) != len(want.shape)
            # A number where a name should be is a size that was baked in while tracing.
            or any(isinstance(b, int) and a != b for a, b in zip(want.shape, shape))
        ):
            raise GraphContractError(
                f"{contract.file_name}: {want.name} should be {want.dtype} {want.shape}, is "
                f"{dtype} {shape}; export the model again"
            )
