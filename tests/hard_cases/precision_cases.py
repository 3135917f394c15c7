"""Numbers that half and int8 cannot hold: saturated as stated, or refused by name."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper
from support.onnx_backbone import CONDITION_CHANNELS, save_graph, tiny_spec

from spotlight_runtime.diffusion.sampler import Predict, sample
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import DDIM
from spotlight_runtime.errors import NumericalError
from spotlight_runtime.networks.models import predictor
from spotlight_runtime.networks.sessions import OnnxGraph, open_graph
from spotlight_spec import ScheduleSpec, graph_contracts

from .case import Case, Refusal

__all__ = ["CASES", "REFUSALS"]

LATENTS = (1, 4, 8, 8)
LEVEL = 2.0**-5
"""Of the quantised graph, which so holds from −4 to 3.97."""
HALF_ROUNDOFF = 2.0**-11
WEIGHT_STEP, SUM_LEVEL = 2.0**-10, 2.0**-3
Parts = tuple[list[onnx.NodeProto], dict[str, np.ndarray]]


def in_half(gain: float) -> Parts:
    """prediction = gain · latents, in half arithmetic."""
    nodes = [
        helper.make_node("Cast", ["latents"], ["half"], to=TensorProto.FLOAT16),
        helper.make_node("Mul", ["half", "gain"], ["product"]),
        helper.make_node("Cast", ["product"], ["prediction"], to=TensorProto.FLOAT),
    ]
    return nodes, {"gain": np.float16(gain)}


def in_int8(gain: float) -> Parts:
    """prediction = gain · latents, the latents rounded to int8."""
    nodes = [
        helper.make_node("QuantizeLinear", ["latents", "level", "zero"], ["whole"]),
        helper.make_node("DequantizeLinear", ["whole", "level", "zero"], ["rounded"]),
        helper.make_node("Mul", ["rounded", "gain"], ["prediction"]),
    ]
    level, zero = np.float32(LEVEL), np.int8(0)
    return nodes, {"level": level, "zero": zero, "gain": np.float32(gain)}


def in_int8_layer(operator: str) -> Parts:
    """prediction = a convolution or product of bytes, written as the exporter writes it."""
    weights = heavy_weights(operator)
    channel_axis = 0 if operator == "Conv" else 1
    nodes = [
        helper.make_node("QuantizeLinear", ["latents", "level", "zero"], ["whole"]),
        helper.make_node("DequantizeLinear", ["whole", "level", "zero"], ["rounded"]),
        helper.make_node(
            "DequantizeLinear", ["weights", "steps", "zeros"], ["used"], axis=channel_axis
        ),
    ]
    numbers = {
        "level": np.float32(LEVEL),
        "zero": np.uint8(128),
        "weights": weights,
        "steps": np.full(weights.shape[0], WEIGHT_STEP, np.float32),
        "zeros": np.zeros(weights.shape[0], np.int8),
    }
    if operator == "MatMul":
        nodes += [
            helper.make_node("Transpose", ["rounded"], ["tokens"], perm=[0, 2, 3, 1]),
            helper.make_node("MatMul", ["tokens", "used"], ["product"]),
            helper.make_node("Transpose", ["product"], ["prediction"], perm=[0, 3, 1, 2]),
        ]
        return nodes, numbers
    nodes += [
        helper.make_node("Conv", ["rounded", "used"], ["sum"], pads=[1] * 4),
        helper.make_node("QuantizeLinear", ["sum", "sum_level", "zero"], ["whole_sum"]),
        helper.make_node("DequantizeLinear", ["whole_sum", "sum_level", "zero"], ["prediction"]),
    ]
    return nodes, numbers | {"sum_level": np.float32(SUM_LEVEL)}


def heavy_weights(operator: str) -> np.ndarray:
    """Weights next to the largest byte, so that any two products pass what 16 bits hold."""
    shape = (4, 4, 3, 3) if operator == "Conv" else (4, 4)
    return np.random.default_rng(1).integers(100, 128, shape).astype(np.int8)


@cache
def denoiser(make: Callable[[Any], Parts], gain: float | str) -> OnnxGraph:
    spec = tiny_spec()
    contracts = graph_contracts(spec, condition_channels=CONDITION_CHANNELS)
    contract = next(each for each in contracts if each.name == "denoiser")
    with tempfile.TemporaryDirectory() as folder:
        save_graph(Path(folder), contract, *make(gain))
        return open_graph(Path(folder), contract, threads=1)


def as_predict(make: Callable[[Any], Parts], gain: float | str) -> Predict:
    condition = np.zeros((1, CONDITION_CHANNELS, *LATENTS[2:]), np.float32)
    return predictor({"denoiser": denoiser(make, gain)}, condition, ScheduleSpec())


def unit(scale: float) -> np.ndarray:
    noise = np.random.default_rng(0).standard_normal(LATENTS, dtype=np.float32)
    return noise * np.float32(scale)


def _half(scale: float) -> tuple[np.ndarray, np.ndarray]:
    z = unit(scale)
    return as_predict(in_half, 0.5)(z, 999), 0.5 * z.astype(np.float64)


def _int8(scale: float) -> tuple[np.ndarray, np.ndarray]:
    z = unit(scale)
    held = np.clip(np.rint(z.astype(np.float64) / LEVEL), -128, 127) * LEVEL
    return as_predict(in_int8, 1.0)(z, 999), held


def _int8_layer(operator: str) -> tuple[np.ndarray, np.ndarray]:
    z = unit(2.0)
    held = np.clip(np.rint(z.astype(np.float64) / LEVEL), -128, 127) * LEVEL
    weights = heavy_weights(operator) * WEIGHT_STEP
    if operator == "MatMul":
        return as_predict(in_int8_layer, operator)(z, 999), np.einsum(
            "nchw,co->nohw", held, weights
        )
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(held, ((0, 0), (0, 0), (1, 1), (1, 1))), (3, 3), axis=(2, 3)
    )
    total = np.einsum("ncijkl,ockl->noij", windows, weights)
    held_total = np.clip(np.rint(total / SUM_LEVEL), -128, 127) * SUM_LEVEL
    return as_predict(in_int8_layer, operator)(z, 999), held_total


def _int8_run(scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Twenty steps of v = z/2 where z saturates, against the same in float64."""
    solver = DDIM(Schedule.trailing(ScheduleSpec(), 20))
    actual = [step.latents for step in sample(as_predict(in_int8, 0.5), unit(scale), solver)]

    def held(z: np.ndarray, timestep: int) -> np.ndarray:
        return 0.5 * np.clip(np.rint(z / LEVEL), -128, 127) * LEVEL

    solver = DDIM(Schedule.trailing(ScheduleSpec(), 20))
    expected = [step.latents for step in sample(held, unit(scale).astype(np.float64), solver)]
    return np.stack(actual), np.stack(expected)


def _run_in_half(gain: float, scale: float) -> None:
    solver = DDIM(Schedule.trailing(ScheduleSpec(), 4))
    for _ in sample(as_predict(in_half, gain), unit(scale), solver):
        pass


CASES = [
    *(
        Case(
            f"latents of {scale:g} in half",
            "the ends of half's range, and below its smallest normal number",
            partial(_half, scale),
            relative=HALF_ROUNDOFF,
            absolute=2.0**-14,  # denormal halves are flushed to zero
        )
        for scale in (1.0, 1e4, 1e-6)
    ),
    *(
        Case(
            f"latents of {scale:g} in int8",
            "values beyond the calibrated range saturate, those below half a level vanish",
            partial(_int8, scale),
            relative=0.0,
        )
        for scale in (1.0, 1e4, 1e-6)
    ),
    *(
        Case(
            f"{operator} of bytes near their largest",
            "processors without VNNI add products of bytes in 16 bits, which saturate",
            partial(_int8_layer, operator),
            relative=1e-6,
        )
        for operator in ("Conv", "MatMul")
    ),
    Case(
        "twenty steps in int8, latents of 1e4",
        "all of the network's inputs saturate at every step",
        partial(_int8_run, 1e4),
        relative=2e-6,
    ),
]
REFUSALS = [
    Refusal(
        f"latents of {scale:g} in half",
        "beyond 65504 there is only infinity",
        partial(_run_in_half, 1.0, scale),
        NumericalError,
        r"^step 0 \(timestep 999\): the denoiser's prediction: \d+ of 256 values are NaN or "
        r"infinite; if the model is fp16",
    )
    for scale in (1e5, 1e30)
]
