"""ᾱ per train step, and the levels an inference run walks through."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_runtime.diffusion.schedule import MULTISTEP_TERMINAL_ALPHA, Schedule, alphas_cumprod
from spotlight_runtime.errors import InvalidInputError
from spotlight_spec import ScheduleSpec

SPEC = ScheduleSpec()


def test_last_train_step_is_pure_noise():
    assert alphas_cumprod(SPEC)[-1] == 0.0


def test_rescaling_keeps_the_first_level():
    plain = alphas_cumprod(replace(SPEC, rescale_betas_zero_snr=False))
    np.testing.assert_allclose(alphas_cumprod(SPEC)[0], plain[0], rtol=1e-14)
    assert plain[0] == pytest.approx(1.0 - 0.00085)
    assert plain[-1] == pytest.approx(0.0046598, rel=1e-4)  # Stable Diffusion's published value


@pytest.mark.parametrize("beta_schedule", ["scaled_linear", "linear"])
@pytest.mark.parametrize("rescale", [True, False])
def test_levels_fall_strictly_within_the_unit_interval(beta_schedule, rescale):
    spec = replace(SPEC, beta_schedule=beta_schedule, rescale_betas_zero_snr=rescale)
    levels = alphas_cumprod(spec)
    assert levels.shape == (1000,)
    assert levels.dtype == np.float64
    assert np.all(np.diff(levels) < 0.0)
    assert 0.0 <= levels[-1] < levels[0] < 1.0


def test_beta_curves_differ_as_named():
    linear = alphas_cumprod(replace(SPEC, beta_schedule="linear", rescale_betas_zero_snr=False))
    betas = 1.0 - linear[1:] / linear[:-1]
    np.testing.assert_allclose(np.diff(betas, 2), 0.0, atol=1e-12)
    scaled = alphas_cumprod(replace(SPEC, rescale_betas_zero_snr=False))
    roots = np.sqrt(1.0 - scaled[1:] / scaled[:-1])
    np.testing.assert_allclose(np.diff(roots, 2), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("steps", "timesteps"),
    [
        (1, [999]),
        (2, [999, 499]),
        (3, [999, 666, 332]),
        (5, [999, 799, 599, 399, 199]),
        (20, list(range(999, 0, -50))),
        (50, list(range(999, 0, -20))),
        (1000, list(range(999, -1, -1))),
    ],
)
def test_trailing_timesteps(steps, timesteps):
    schedule = Schedule.trailing(SPEC, steps)
    assert schedule.timesteps.tolist() == timesteps
    assert schedule.timesteps.dtype == np.int64
    assert len(schedule) == steps


@given(st.integers(1, 1000), st.booleans())
def test_every_run_starts_at_pure_noise_and_walks_down(steps, to_one):
    spec = replace(SPEC, set_alpha_to_one=to_one)
    schedule = Schedule.trailing(spec, steps)
    assert schedule.timesteps[0] == 999
    assert np.all(np.diff(schedule.timesteps) < 0)
    assert schedule.timesteps[-1] >= 0
    assert schedule.alpha_bar.shape == (steps + 1,)
    assert schedule.alpha_bar[0] == 0.0
    assert np.all(np.diff(schedule.alpha_bar) >= 0.0)
    assert schedule.alpha_bar[-1] == (1.0 if to_one else alphas_cumprod(spec)[0])


def test_levels_are_those_of_the_timesteps():
    schedule = Schedule.trailing(SPEC, 7)
    np.testing.assert_array_equal(schedule.alpha_bar[:-1], alphas_cumprod(SPEC)[schedule.timesteps])


@pytest.mark.parametrize("steps", [0, -1, 1001, 2.0, "20", None, True, np.nan])
def test_bad_step_counts_are_named(steps):
    with pytest.raises(InvalidInputError, match=r"steps: expected a whole number from 1 to 1000"):
        Schedule.trailing(SPEC, steps)


def test_clipping_is_carried_along():
    assert Schedule.trailing(replace(SPEC, clip_sample=True), 3).for_multistep().clip_sample
    assert not Schedule.trailing(SPEC, 3).clip_sample


@pytest.mark.parametrize("steps", [1, 2, 20, 1000])
def test_multistep_levels_have_finite_log_snr_but_the_last(steps):
    schedule = Schedule.trailing(SPEC, steps)
    multistep = schedule.for_multistep()
    levels = multistep.alpha_bar
    assert levels[0] == MULTISTEP_TERMINAL_ALPHA
    assert levels[-1] == 1.0
    assert np.all(np.isfinite(np.log(levels[:-1] / (1.0 - levels[:-1]))))
    np.testing.assert_array_equal(levels[1:-1], schedule.alpha_bar[1:-1])
    assert schedule.alpha_bar[0] == 0.0, "the schedule it was made from is left alone"
