"""Whole runs of the loop: the bench's cases, in float32 and in float64, against the oracle."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from oracle.loop import Branch, Draws, Knobs, spotlight
from oracle.schedule import scaled_linear_alpha_bar, trailing_timesteps, zero_terminal_snr
from torch import Tensor

from spotlight_bench.stability import trajectory
from spotlight_bench.stability_cases import LOOP_CASES, LoopCase
from spotlight_bench.stability_network import Precision, SmallDenoiser

from .case import Case

__all__ = ["CASES", "oracle_trajectory"]

ALPHA_BAR = zero_terminal_snr(scaled_linear_alpha_bar())
TOLERANCE = {"fp64": 2e-11, "fp32": 5e-6}
SMALLEST = 2.0**-149
"""What float32 denormals are multiples of: below it there are no digits."""


def predict(z: Tensor, t: int, conditioning: Tensor) -> Tensor:
    """The small denoiser in float64, a branch at a time."""
    network = SmallDenoiser(conditioning.numpy()[None], "fp64")
    return torch.from_numpy(network(z.numpy()[None], t)[0])


def oracle_trajectory(case: LoopCase) -> list[np.ndarray]:
    """Both branches' latents after every step, shape (2, C, h, w)."""
    arrays = case.inputs(np.float64)
    condition, composites, masks = (
        torch.from_numpy(array)
        for array in (arrays.conditioning, arrays.composite_latents, arrays.shadow_mask)
    )
    branches = [Branch(condition[i], composites[i], masks[i]) for i in (0, 1)]
    initial = torch.from_numpy(arrays.initial_noise[0])
    blends = list(torch.from_numpy(arrays.step_noise))
    history = spotlight(
        predict,
        *branches,
        torch.from_numpy(arrays.guidance_mask[0]),
        Draws(initial, blends),
        trailing_timesteps(case.steps),
        ALPHA_BAR,
        ALPHA_BAR[0],
        Knobs(case.gamma, case.beta, case.rescale, case.fidelity, case.solver),
    )
    return [torch.stack(pair).numpy() for pair in history]


def _build(case: LoopCase, precision: Precision) -> tuple[np.ndarray, np.ndarray]:
    network = SmallDenoiser(case.condition(), precision)
    actual = trajectory(case, case.inputs(network.dtype), network)
    assert all(each.dtype == network.dtype for each in actual)
    return np.stack(actual), np.stack(oracle_trajectory(case))


CASES = [
    Case(
        name=f"{case.name} ({precision})",
        why=case.why,
        build=partial(_build, case, precision),
        relative=relative,
        absolute=100.0 * SMALLEST,
        full=case.full,
    )
    for case in LOOP_CASES
    for precision, relative in TOLERANCE.items()
]
