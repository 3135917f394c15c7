"""ONNX Runtime as the exporter uses it, at every optimisation level."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy.typing as npt
import onnxruntime as ort

from spotlight_export.errors import VerificationError

__all__ = ["LEVELS", "Network", "open_graph"]

Arrays = dict[str, npt.NDArray[Any]]
Network = Callable[..., Arrays]
"""``network(**named_arrays)`` → named arrays, as the runtime calls a graph."""

LEVELS: Final = {
    "disable": ort.GraphOptimizationLevel.ORT_DISABLE_ALL,
    "basic": ort.GraphOptimizationLevel.ORT_ENABLE_BASIC,
    "extended": ort.GraphOptimizationLevel.ORT_ENABLE_EXTENDED,
    "all": ort.GraphOptimizationLevel.ORT_ENABLE_ALL,
}

EXTERNAL_DATA_FOLDER: Final = "session.model_external_initializers_file_folder_path"
"""Session option that says where a graph given as bytes finds its weights."""


def open_graph(path: Path, level: str = "all", variant: bytes | None = None) -> Network:
    """Open a graph file as a network.

    Parameters
    ----------
    path : Path
    level : {"disable", "basic", "extended", "all"}
    variant : bytes, optional
        A serialised graph to run in place of the file's, with the file's external data.

    Raises
    ------
    VerificationError
        If ONNX Runtime refuses the file.
    """
    options = ort.SessionOptions()
    options.graph_optimization_level = LEVELS[level]
    # ONNX Runtime would count the host's cores, not those this process may use.
    options.intra_op_num_threads = len(os.sched_getaffinity(0))
    options.log_severity_level = 3
    options.add_session_config_entry(EXTERNAL_DATA_FOLDER, str(path.parent))
    # As the runtime runs it: without VNNI sums of products of bytes would saturate.
    options.add_session_config_entry("session.x64quantprecision", "1")
    try:
        session = ort.InferenceSession(variant or path, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise VerificationError(
            f"{path}: ONNX Runtime {ort.__version__} refuses this graph at optimisation level "
            f"{level!r}: {str(error).strip()}. Install onnxruntime >= 1.23, or export again"
        ) from error
    names = [output.name for output in session.get_outputs()]

    def network(**inputs: npt.NDArray[Any]) -> Arrays:
        return dict(zip(names, session.run(names, inputs)))

    return network
