"""Ranges of activations over whole denoising loops on made-up maps and noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import onnx_ir as ir

from spotlight_export.quantise import Range, tensors_to_observe
from spotlight_export.sessions import Network, open_graph
from spotlight_export.trajectory import made_up_inputs, run_loop
from spotlight_spec import BackboneSpec

__all__ = ["observe_ranges"]

SEEDS: Final = (1, 2, 3)
"""Calibration runs, each with noise, conditioning and masks of its own."""

LATENT_SIZE: Final = (32, 40)
"""Size of the calibration runs: ranges hardly depend on it, their cost does."""


class _Observed:
    """A graph that also reports the extremes of chosen tensors, and remembers them."""

    def __init__(self, source: Path) -> None:
        model = ir.load(source)
        self._names = tensors_to_observe(model)
        _add_extremes(model.graph, self._names)
        self._network = open_graph(source, variant=ir.to_proto(model).SerializeToString())
        self.ranges: dict[str, Range] = {}

    def __call__(self, **inputs: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        outputs = self._network(**inputs)
        for name in self._names:
            low, high = float(outputs.pop(f"{name}.min")), float(outputs.pop(f"{name}.max"))
            before = self.ranges.get(name, (low, high))
            self.ranges[name] = (float(np.fmin(before[0], low)), float(np.fmax(before[1], high)))
        return outputs


def observe_ranges(
    sources: dict[str, Path],
    condition_encoder: Path,
    spec: BackboneSpec,
    report: Callable[[str], None],
) -> dict[str, dict[str, Range]]:
    """Run whole relights and record the range of every tensor that is to be quantised.

    Parameters
    ----------
    sources : dict of Path
        Float32 graph file of ``denoiser``, perhaps with ``denoiser_shallow``, or of ``controlnet``
        and ``unet``.
    condition_encoder : Path
    spec : BackboneSpec
    report : callable
        Told what is being done.

    Returns
    -------
    dict of dict of (float, float)
        Ranges by tensor, by graph.
    """
    networks = {name: _Observed(path) for name, path in sources.items()}
    encode: Network = open_graph(condition_encoder)
    for run, seed in enumerate(SEEDS, start=1):
        report(f"calibrating, run {run} of {len(SEEDS)}")
        inputs = made_up_inputs(spec, LATENT_SIZE, np.random.default_rng(seed))
        condition = encode(conditioning=inputs.conditioning)["condition"]
        run_loop(networks, condition, inputs, spec)
        if "denoiser_shallow" in networks:
            run_loop(networks, condition, inputs, spec, reuse=2)
    return {name: network.ranges for name, network in networks.items()}


def _add_extremes(graph: ir.Graph, names: list[str]) -> None:
    values = {value.name: value for node in graph for value in node.outputs}
    values |= {value.name: value for value in graph.inputs}
    for name in names:
        for op_type, suffix in (("ReduceMin", "min"), ("ReduceMax", "max")):
            node = ir.node(op_type, [values[name]], {"keepdims": 0})
            output = node.outputs[0]
            output.name = f"{name}.{suffix}"
            output.type, output.shape = ir.TensorType(ir.DataType.FLOAT), ir.Shape([])
            graph.append(node)
            graph.outputs.append(output)
