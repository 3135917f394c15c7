"""The runtime's solvers against diffusers' schedulers, step by step.

Both run freely on the same nonlinear network, so an error made early is carried on. What limits
the agreement is diffusers: it keeps the schedule in float32, and its multistep schedulers the
latents too.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from diffusers import DDIMScheduler, DPMSolverMultistepScheduler, UniPCMultistepScheduler
from oracle import schedule as method

from spotlight_runtime.diffusion.schedule import Schedule, alphas_cumprod
from spotlight_runtime.diffusion.solvers import make_solver
from spotlight_spec import ScheduleSpec

from .measure import Tolerance, assert_within

pytestmark = pytest.mark.filterwarnings(
    "ignore:__array__ implementation doesn't accept a copy keyword:DeprecationWarning:diffusers"
)

SPEC = ScheduleSpec()
PUBLISHED = {
    "num_train_timesteps": SPEC.num_train_timesteps,
    "beta_start": 0.00085,
    "beta_end": 0.012,
    "beta_schedule": "scaled_linear",
    "prediction_type": "v_prediction",
    "timestep_spacing": "trailing",
    "rescale_betas_zero_snr": True,
}
SCHEDULERS = {
    "ddim": lambda: DDIMScheduler(**PUBLISHED, set_alpha_to_one=False, clip_sample=False),
    "dpmpp_2m": lambda: DPMSolverMultistepScheduler(
        **PUBLISHED,
        algorithm_type="dpmsolver++",
        solver_order=2,
        final_sigmas_type="zero",
        lower_order_final=True,
    ),
    "unipc": lambda: UniPCMultistepScheduler(
        **PUBLISHED, solver_order=2, solver_type="bh2", predict_x0=True, final_sigmas_type="zero"
    ),
}
STEPS = [1, 2, 5, 20, 50]
TOLERANCE = Tolerance(relative=2e-6, absolute=5e-6)
_MIX = np.random.default_rng(7).normal(size=(4, 4)) / 2.0


def fake_network(z: np.ndarray, timestep: int) -> np.ndarray:
    """A fixed nonlinear v(z, t) with v and z of one size."""
    mixed = np.einsum("dc,bchw->bdhw", _MIX, z)
    return np.tanh(mixed) + 0.5 * np.sin(2.0 * z + timestep / 100.0)


def first_latents() -> np.ndarray:
    return np.random.default_rng(3).standard_normal((2, 4, 5, 7))


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("solver", SCHEDULERS)
def test_every_step_is_diffusers(solver: str, steps: int) -> None:
    ours = make_solver(solver, Schedule.trailing(SPEC, steps))
    theirs = SCHEDULERS[solver]()
    theirs.set_timesteps(steps)
    assert ours.schedule.timesteps.tolist() == theirs.timesteps.tolist()
    z = first_latents()
    reference = torch.from_numpy(first_latents())
    for i, t in enumerate(theirs.timesteps):
        z, _ = ours.step(i, z, fake_network(z, int(t)))
        v = torch.from_numpy(fake_network(reference.numpy(), int(t)))
        reference = theirs.step(v, t, reference).prev_sample
        assert_within(TOLERANCE, z, reference, f"{solver}, step {i} of {steps}")


@pytest.mark.parametrize("steps", STEPS)
def test_ddim_is_the_oracle_to_rounding(steps: int) -> None:
    schedule = Schedule.trailing(SPEC, steps)
    solver = make_solver("ddim", schedule)
    alpha_bar = method.zero_terminal_snr(method.scaled_linear_alpha_bar())
    levels = method.noise_levels(method.trailing_timesteps(steps), alpha_bar, alpha_bar[0])
    z = first_latents()
    reference = torch.from_numpy(first_latents())
    for i, t in enumerate(method.trailing_timesteps(steps)):
        z, _ = solver.step(i, z, fake_network(z, t))
        v = torch.from_numpy(fake_network(reference.numpy(), t))
        reference = method.ddim_step(reference, v, levels[i], levels[i + 1])
        assert_within(Tolerance(1e-12, 1e-11), z, reference, f"step {i} of {steps}")


def test_ddim_clips_as_diffusers_does() -> None:
    spec = ScheduleSpec(clip_sample=True, set_alpha_to_one=True)
    ours = make_solver("ddim", Schedule.trailing(spec, 5))
    theirs = DDIMScheduler(**PUBLISHED, set_alpha_to_one=True, clip_sample=True)
    theirs.set_timesteps(5)
    z, reference = first_latents(), torch.from_numpy(first_latents())
    for i, t in enumerate(theirs.timesteps):
        z, _ = ours.step(i, z, fake_network(z, int(t)))
        v = torch.from_numpy(fake_network(reference.numpy(), int(t)))
        reference = theirs.step(v, t, reference).prev_sample
        assert_within(TOLERANCE, z, reference, f"step {i}")


def test_alpha_bar_is_the_oracle_and_diffusers() -> None:
    expected = method.zero_terminal_snr(method.scaled_linear_alpha_bar())
    assert_within(Tolerance(1e-13, 1e-13), alphas_cumprod(SPEC), expected)
    assert alphas_cumprod(SPEC)[-1] == expected[-1] == 0.0
    theirs = SCHEDULERS["ddim"]().alphas_cumprod
    assert_within(Tolerance(1e-6, 1e-6), alphas_cumprod(SPEC), theirs)


@pytest.mark.parametrize("steps", [1, 2, 3, 4, 5, 7, 16, 20, 30, 50, 333, 999, 1000])
def test_timesteps_are_the_oracle_and_diffusers(steps: int) -> None:
    scheduler = SCHEDULERS["ddim"]()
    scheduler.set_timesteps(steps)
    ours = Schedule.trailing(SPEC, steps).timesteps.tolist()
    assert ours == method.trailing_timesteps(steps) == scheduler.timesteps.tolist()
