"""ODE solvers against problems whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest

from spotlight_runtime.diffusion.schedule import Schedule, alphas_cumprod
from spotlight_runtime.diffusion.solvers import SOLVERS, DPMSolverPP, UniPC, make_solver
from spotlight_runtime.errors import InvalidInputError
from spotlight_spec import ScheduleSpec

SPEC = ScheduleSpec(set_alpha_to_one=True)
STEPS = [1, 2, 3, 5, 20, 50, 1000]
SHAPE = (2, 4, 3, 5)


def solve(name, steps, network, start, spec=SPEC):
    """Latents after the run; ``network(z, alpha, sigma) -> v`` sees the solver's own levels."""
    solver = make_solver(name, Schedule.trailing(spec, steps))
    z = start
    for i in range(steps):
        level = solver.schedule.alpha_bar[i]
        z, x0 = solver.step(i, z, network(z, np.sqrt(level), np.sqrt(1.0 - level)))
        assert np.isfinite(z).all(), f"{name}, step {i} of {steps}"
        assert np.isfinite(x0).all()
    return z, x0


def start_of(name, x0, noise):
    level = make_solver(name, Schedule.trailing(SPEC, 1)).schedule.alpha_bar[0]
    return np.sqrt(level) * x0 + np.sqrt(1.0 - level) * noise


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("name", SOLVERS)
def test_exact_velocity_of_one_picture_lands_on_it(name, steps, rng):
    x0, noise = rng.standard_normal((2, *SHAPE))
    network = lambda z, alpha, sigma: alpha * noise - sigma * x0  # noqa: E731
    z, denoised = solve(name, steps, network, start_of(name, x0, noise))
    np.testing.assert_allclose(z, x0, atol=1e-5)
    np.testing.assert_allclose(denoised, x0, atol=1e-5)


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("name", SOLVERS)
def test_network_that_knows_the_picture_pulls_any_start_onto_it(name, steps, rng):
    x0, start = rng.standard_normal((2, *SHAPE))
    network = lambda z, alpha, sigma: (alpha * z - x0) / sigma  # noqa: E731
    z, _ = solve(name, steps, network, start)
    np.testing.assert_allclose(z, x0, atol=1e-5)


@pytest.mark.parametrize("name", SOLVERS)
def test_float32_stays_float32(name, rng):
    x0, noise = rng.standard_normal((2, *SHAPE)).astype(np.float32)

    def network(z, alpha, sigma):
        return (np.float32(alpha) * z - x0) / np.float32(sigma)

    z, _ = solve(name, 20, network, noise)
    assert z.dtype == np.float32
    np.testing.assert_allclose(z, x0, atol=1e-4)


@pytest.mark.parametrize("name", SOLVERS)
def test_pure_noise_is_a_finite_start_for_garbage_too(name, rng):
    """ᾱ = 0 divides nothing by zero, whatever the network says."""
    start = rng.standard_normal(SHAPE)
    solve(name, 20, lambda z, alpha, sigma: 1e3 * np.sin(1e3 * z), start)


def gaussian_errors(name, steps, s):
    """Error after each step against the exact flow of N(0, s²) data."""
    start = np.linspace(-2.0, 2.0, 9)
    solver = make_solver(name, Schedule.trailing(SPEC, steps))
    levels = solver.schedule.alpha_bar
    z, errors = start, []
    for i in range(steps):
        alpha, sigma = np.sqrt(levels[i]), np.sqrt(1.0 - levels[i])
        x0 = alpha * s**2 / (alpha**2 * s**2 + sigma**2) * z
        z, _ = solver.step(i, z, (alpha * z - x0) / sigma)
        exact = start * np.sqrt(levels[i + 1] * s**2 + 1.0 - levels[i + 1])
        errors.append(float(np.abs(z - exact).max()))
    return errors


@pytest.mark.parametrize("s", [0.7, 2.0])
@pytest.mark.parametrize("name", ["dpmpp_2m", "unipc"])
def test_second_order_solvers_follow_the_flow_closer_than_ddim(name, s):
    """Before the last step, which is first order in all of them, several times closer."""
    for steps in (10, 20, 50):
        ours, ddim = gaussian_errors(name, steps, s), gaussian_errors("ddim", steps, s)
        assert ours[-2] < 0.3 * ddim[-2]
        assert ours[-1] < ddim[-1]


@pytest.mark.parametrize("s", [0.3, 2.0])
@pytest.mark.parametrize("name", SOLVERS)
def test_more_steps_come_closer(name, s):
    few, more, many = (gaussian_errors(name, steps, s)[-1] for steps in (5, 20, 100))
    assert many < 0.5 * more < 0.5 * few


@pytest.mark.parametrize("name", SOLVERS)
def test_final_level_of_the_first_train_step_keeps_its_noise(name, rng):
    """Without ``set_alpha_to_one`` DDIM stops at ᾱ₀; multistep solvers always land on x0."""
    spec = replace(SPEC, set_alpha_to_one=False)
    x0, noise = rng.standard_normal((2, *SHAPE))
    network = lambda z, alpha, sigma: alpha * noise - sigma * x0  # noqa: E731
    z, _ = solve(name, 20, network, start_of(name, x0, noise), spec)
    first = alphas_cumprod(spec)[0]
    rest = np.sqrt(1.0 - first) * noise if name == "ddim" else 0.0
    scale = np.sqrt(first) if name == "ddim" else 1.0
    np.testing.assert_allclose(z, scale * x0 + rest, atol=1e-5)


def test_ddim_rotates(rng):
    """With α = cos φ and σ = sin φ a step is a rotation of (z, v): lengths are kept."""
    z, v = rng.standard_normal((2, *SHAPE))
    solver = make_solver("ddim", Schedule.trailing(SPEC, 20))
    z_next, x0 = solver.step(4, z, v)
    phi = np.arccos(np.sqrt(solver.schedule.alpha_bar[4:6]))
    turn = phi[1] - phi[0]
    np.testing.assert_allclose(z_next, np.cos(turn) * z + np.sin(turn) * v, atol=1e-12)
    np.testing.assert_allclose(x0, np.cos(phi[0]) * z - np.sin(phi[0]) * v, atol=1e-12)


@pytest.mark.parametrize("name", SOLVERS)
def test_clipped_prediction_stays_in_range(name, rng):
    start = 10.0 * rng.standard_normal(SHAPE)
    spec = replace(SPEC, clip_sample=True)
    z, x0 = solve(name, 5, lambda z, alpha, sigma: -50.0 * z, start, spec)
    assert np.abs(x0).max() == 1.0
    np.testing.assert_allclose(z, x0, atol=1e-12)


@pytest.mark.parametrize("kind", [DPMSolverPP, UniPC])
def test_multistep_solvers_remember_and_a_fresh_one_does_not(kind, rng):
    schedule = Schedule.trailing(SPEC, 5)
    z, v0, v1 = rng.standard_normal((3, *SHAPE))
    run, fresh = kind(schedule), kind(schedule)
    arrived, _ = run.step(0, z, v0)
    other_start = fresh.step(0, z, v1)[0]
    second = run.step(1, arrived, v1)[0]
    assert not np.array_equal(second, fresh.step(1, other_start, v1)[0])
    again = kind(schedule)
    again.step(0, z, v0)
    np.testing.assert_array_equal(again.step(1, arrived, v1)[0], second)


def test_solvers_leave_their_inputs_alone(rng):
    z, v = rng.standard_normal((2, *SHAPE))
    for array in (z, v):
        array.setflags(write=False)
    for name in SOLVERS:
        solver = make_solver(name, Schedule.trailing(SPEC, 3))
        for i in range(3):
            solver.step(i, z, v)


@pytest.mark.parametrize("name", ["euler", "", None, "DDIM"])
def test_unknown_solver_is_named_with_the_known_ones(name):
    with pytest.raises(InvalidInputError, match="expected one of ddim, dpmpp_2m, unipc"):
        make_solver(name, Schedule.trailing(SPEC, 3))
