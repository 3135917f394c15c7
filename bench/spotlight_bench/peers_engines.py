"""The engines that run the same networks: each as the runtime's mapping of plain callables.

So the runtime's own loop runs them all: same noise, same steps, same arithmetic around them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy.typing as npt

from spotlight_runtime.networks.models import open_networks, resolve_model

__all__ = ["ENGINES", "HALF", "Engine", "open_engine"]

Arrays = dict[str, npt.NDArray[Any]]
Networks = Mapping[str, Callable[..., Arrays]]
Engine = Literal["torch", "onnxruntime", "openvino", "spotlight"]

HALF: Final = "openvino-bf16"
"""The runtime's engine for processors that multiply bfloat16."""
ENGINES: Final = ("torch", "onnxruntime", "openvino", "spotlight")


def open_engine(engine: str, source: Path, precision: str, threads: int) -> Networks:
    """Networks on an engine.

    Parameters
    ----------
    engine : {"torch", "onnxruntime", "openvino", "spotlight"}
    source : Path
        A checkpoint for torch, a folder of graphs for ONNX Runtime and OpenVINO, a model folder
        for ours.
    precision : str
        ``fp32`` or ``bf16``; of ONNX Runtime also ``unoptimised``; ours is the model's own, or
        ``openvino-bf16``, the runtime's other engine.
    threads : int
    """
    if engine == "torch":
        from spotlight_bench.peers_torch import networks

        return networks(source, half=precision == "bf16", threads=threads)
    if engine == "spotlight":
        ours = HALF if precision == HALF else "onnxruntime"
        return open_networks(resolve_model(source), engine=ours, threads=threads)
    graphs = {path.stem: path for path in sorted(source.glob("*.onnx"))}
    opener = _onnxruntime if engine == "onnxruntime" else _openvino
    found = {name: opener(path, precision, threads) for name, path in graphs.items()}
    # A plain export has its maps go into the denoiser, which embeds them at every step.
    return {"condition_encoder": lambda conditioning: {"condition": conditioning}} | found


def _onnxruntime(path: Path, precision: str, threads: int) -> Callable[..., Arrays]:
    """A session as anyone opens one; only the threads are said, so that all have as many."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    if precision == "unoptimised":
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = _Late(
        lambda: ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    )

    def run(**inputs: npt.NDArray[Any]) -> Arrays:
        names = [output.name for output in session().get_outputs()]
        return dict(zip(names, session().run(names, inputs)))

    return run


def _openvino(path: Path, precision: str, threads: int) -> Callable[..., Arrays]:
    """A model compiled for the sizes it is first asked at, in the precision asked for."""
    import openvino as ov

    settings = {
        "INFERENCE_PRECISION_HINT": "bf16" if precision == "bf16" else "f32",
        "INFERENCE_NUM_THREADS": threads,
        "PERFORMANCE_HINT": "LATENCY",
    }
    compiled: list[Any] = []

    def run(**inputs: npt.NDArray[Any]) -> Arrays:
        if not compiled:
            core = ov.Core()
            model = core.read_model(str(path))
            model.reshape({name: list(array.shape) for name, array in inputs.items()})
            compiled.append(core.compile_model(model, "CPU", settings))
        found = compiled[0](inputs)
        return {output.any_name: found[output].astype("float32") for output in compiled[0].outputs}

    return run


class _Late:
    """Something made when it is first asked for."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make
        self._made: Any = None

    def __call__(self) -> Any:
        if self._made is None:
            self._made = self._make()
        return self._made
