"""Rounding errors grow no faster than `docs/stability.md` derives."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from spotlight_bench.stability import UNIT_ROUNDOFF, Measured, in_float64, measure, trajectory
from spotlight_bench.stability_cases import LOOP_CASES, LoopCase
from spotlight_bench.stability_network import CHANNELS, SmallDenoiser
from spotlight_runtime.diffusion.guidance import masked_guidance
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_spec import ScheduleSpec

SEEDS = (0, 1)
"""Besides a case's own: errors of a few latents scatter, of all runs together less."""
GROWTH = 10.0
ROUNDINGS = 6.0
"""c of the bound: the network rounds a few times itself, which shows where steps are few."""
FIFTY = [case for case in LOOP_CASES if case.steps == 50]


@cache
def measured(case: LoopCase) -> tuple[Measured, float]:
    """The case in float32, and its largest sensitivity in float64, at least 1."""
    exact = in_float64(case)
    sensitivity = max(1.0, *measure(case, "fp64", exact).sensitivities)
    return measure(case, "fp32", exact), sensitivity


def together(errors: list[float]) -> float:
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


@pytest.mark.parametrize("case", FIFTY, ids=lambda case: case.name)
def test_fifty_steps_err_ten_times_as_much_as_one_at_most(case: LoopCase) -> None:
    """What a run amplifies by itself, its errors included, is not counted as growth."""
    runs, sensitivities = zip(*(measured(replace(case, seed=s)) for s in (case.seed, *SEEDS)))
    one = together([run.one_step for run in runs])
    fifty = together([run.errors[-1] for run in runs])
    assert fifty <= GROWTH * max(sensitivities) * one
    assert max(sensitivities) < 1.5 or case.gamma > 7.0


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=case.name, marks=[pytest.mark.full] if case.full else [])
        for case in LOOP_CASES
    ],
)
def test_errors_grow_like_the_root_of_the_steps(case: LoopCase) -> None:
    run, sensitivity = measured(case)
    for step, error in enumerate(run.errors, start=1):
        assert error <= ROUNDINGS * sensitivity * math.sqrt(step) * UNIT_ROUNDOFF, f"step {step}"


@pytest.mark.parametrize("steps", [1, 2, 3, 20, 50, 1000])
def test_all_steps_together_turn_by_a_quarter(steps: int) -> None:
    """A DDIM step turns (z, v) by the difference of angles; what bounds a run is their sum."""
    alpha_bar = Schedule.trailing(ScheduleSpec(), steps).alpha_bar
    angles = np.arccos(np.sqrt(alpha_bar))
    turns = -np.diff(angles)
    assert (turns >= 0.0).all()
    assert turns.sum() <= math.pi / 2.0
    for lipschitz in (1.0, 3.0, 30.0):
        grown = np.prod(np.cos(turns) + lipschitz * np.sin(turns))
        assert grown <= math.exp(lipschitz * turns.sum())


@pytest.mark.parametrize("gamma", [1.0, 3.0, 7.0, 15.0])
def test_a_run_amplifies_no_more_than_its_prediction_allows(gamma: float) -> None:
    """exp(Λ·π/2), with Λ measured: the norm of the guided prediction's derivative."""
    case = LoopCase("small", "its derivative is taken whole", size=(3, 3), gamma=gamma, steps=20)
    arrays, network = case.inputs(np.float64), SmallDenoiser(case.condition())
    shape = (1, CHANNELS, *case.size)
    count = math.prod(shape)
    latents = trajectory(case, arrays, network)

    def guided(flat: np.ndarray, timestep: int) -> np.ndarray:
        v = network(flat.reshape(2, *shape[1:]), timestep)
        return masked_guidance(v[:1], v[1:], arrays.guidance_mask, gamma).ravel()

    def derivative(z: np.ndarray, timestep: int) -> float:
        columns = [
            (guided(z.ravel() + d, timestep) - guided(z.ravel() - d, timestep)) / 2e-6
            for d in 1e-6 * np.eye(2 * count)
        ]
        return float(np.linalg.norm(np.stack(columns, axis=1), ord=2))

    # Both branches are stepped by the one guided prediction, so it acts on them √2 as strongly.
    timesteps = Schedule.trailing(ScheduleSpec(), case.steps).timesteps.tolist()
    largest = math.sqrt(2.0) * max(derivative(z, t) for z, t in zip(latents[::5], timesteps[1::5]))
    amplified = max(measure(case, "fp64", latents).sensitivities)
    assert amplified <= math.exp(largest * math.pi / 2.0)
