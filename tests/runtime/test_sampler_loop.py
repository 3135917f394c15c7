"""The loop: a generator over plain functions, and what SpotLight adds to it."""

from dataclasses import fields, replace

import numpy as np
import pytest

from spotlight_runtime.diffusion.blending import add_noise, blend_shadow
from spotlight_runtime.diffusion.guidance import masked_guidance
from spotlight_runtime.diffusion.sampler import LoopInputs, sample, shadow_guided
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import DDIM, make_solver
from spotlight_runtime.errors import NumericalError, ShapeError
from spotlight_spec import ScheduleSpec

SPEC = ScheduleSpec()
LATENT = (4, 3, 5)


def solver_of(steps, name="ddim"):
    return make_solver(name, Schedule.trailing(SPEC, steps))


def network(z, timestep):
    """Deterministic, and different for the two branches through their latents and position."""
    branch = np.arange(len(z), dtype=np.float32).reshape(-1, 1, 1, 1)
    return np.sin(z + np.float32(1e-3 * timestep) + branch)


def make_inputs(branches=2, steps=5, seed=0):
    rng = np.random.default_rng(seed)
    normal = lambda *shape: rng.standard_normal(shape, dtype=np.float32)  # noqa: E731
    return LoopInputs(
        conditioning=normal(branches, 11, 24, 40),
        composite_latents=normal(branches, *LATENT),
        shadow_mask=rng.integers(0, 3, (branches, 1, 3, 5)).astype(np.float32),
        guidance_mask=rng.random((1, 1, 3, 5), dtype=np.float32),
        initial_noise=normal(1, *LATENT),
        step_noise=normal(max(steps - 1, 1), *LATENT),
    )


def arrays_of(inputs):
    """Its arrays by name."""
    found = {field.name: getattr(inputs, field.name) for field in fields(inputs)}
    return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}


def last(trajectory):
    return list(trajectory)[-1].latents


def test_yields_after_each_step_in_order(rng):
    start = rng.standard_normal((1, *LATENT), dtype=np.float32)
    steps = list(sample(network, start, solver_of(5)))
    assert [s.index for s in steps] == [0, 1, 2, 3, 4]
    assert [s.timestep for s in steps] == [999, 799, 599, 399, 199]
    for step in steps:
        assert step.latents.shape == step.denoised.shape == start.shape
        assert step.latents.dtype == np.float32


def test_is_the_solver_and_nothing_else(rng):
    z = start = rng.standard_normal((1, *LATENT), dtype=np.float32)
    schedule = Schedule.trailing(SPEC, 4)
    solver = DDIM(schedule)
    for i, t in enumerate(schedule.timesteps.tolist()):
        z, _ = solver.step(i, z, network(z, t))
    np.testing.assert_array_equal(last(sample(network, start, solver_of(4))), z)


def test_network_is_asked_only_when_the_caller_wants_a_step(rng):
    asked = []

    def counting(z, timestep):
        asked.append(timestep)
        return network(z, timestep)

    run = sample(counting, rng.standard_normal((1, *LATENT), dtype=np.float32), solver_of(5))
    assert asked == []
    next(run)
    assert asked == [999]
    next(run)
    run.close()
    assert asked == [999, 799]
    assert list(run) == []


def test_blend_follows_every_step_but_the_last(rng):
    seen = []

    def blend(index, z):
        seen.append(index)
        return z + 1.0

    start = rng.standard_normal((1, *LATENT), dtype=np.float32)
    steps = list(sample(network, start, solver_of(4), blend=blend))
    assert seen == [0, 1, 2]
    plain = list(sample(network, start, solver_of(4)))
    np.testing.assert_array_equal(steps[0].latents, plain[0].latents + 1.0)


def test_one_step_is_never_blended(rng):
    def blend(index, z):
        raise AssertionError("blended")

    start = rng.standard_normal((1, *LATENT), dtype=np.float32)
    assert len(list(sample(network, start, solver_of(1), blend=blend))) == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("at", [0, 2])
def test_prediction_that_is_not_finite_names_the_step(rng, bad, at):
    timesteps = Schedule.trailing(SPEC, 4).timesteps

    def broken(z, timestep):
        v = network(z, timestep)
        if timestep == timesteps[at]:
            v[0, 1, 2, 3] = bad
        return v

    run = sample(broken, rng.standard_normal((1, *LATENT), dtype=np.float32), solver_of(4))
    for _ in range(at):
        next(run)
    named = rf"step {at} \(timestep {timesteps[at]}\): the network's prediction: 1 of 60"
    with pytest.raises(NumericalError, match=named):
        next(run)


def test_latents_that_are_not_finite_name_the_step(rng):
    start = rng.standard_normal((1, *LATENT), dtype=np.float32)
    spoil = lambda index, z: z * np.float32(np.nan if index == 1 else 1.0)  # noqa: E731
    run = sample(network, start, solver_of(4), blend=spoil)
    next(run)
    with pytest.raises(NumericalError, match=r"step 1 \(timestep 749\): the latents: 60 of 60"):
        next(run)


@pytest.mark.parametrize("fidelity", ["paper", "release"])
@pytest.mark.parametrize("gamma", [1.0, 3.0])
@pytest.mark.parametrize("beta", [0.0, 0.05, 0.6])
def test_shadow_guided_is_the_method_step_by_step(fidelity, gamma, beta):
    """Method §4 with the pure functions, written out."""
    inputs = make_inputs()
    schedule = Schedule.trailing(SPEC, 5)
    solver = DDIM(schedule)
    z = np.repeat(inputs.initial_noise, 2, axis=0)
    run = shadow_guided(network, inputs, solver_of(5), gamma=gamma, beta=beta, fidelity=fidelity)
    for i, (step, t) in enumerate(zip(run, schedule.timesteps.tolist())):
        both = network(z, t)
        v = masked_guidance(both[:1], both[1:], inputs.guidance_mask, gamma)
        z, _ = solver.step(i, z, v)
        if i < 4 and beta > 0.0:
            level = schedule.alpha_bar[i if fidelity == "release" else i + 1]
            noised = add_noise(inputs.composite_latents, inputs.step_noise[i], level)
            z = blend_shadow(z, noised, inputs.shadow_mask, beta)
        np.testing.assert_array_equal(step.latents, z)


def test_branches_start_alike_and_part_at_the_first_blend():
    inputs = make_inputs()
    steps = list(shadow_guided(network, inputs, solver_of(5), beta=0.05))
    np.testing.assert_array_equal(*steps[0].denoised)
    assert not np.array_equal(*steps[0].latents)
    unblended = list(shadow_guided(network, inputs, solver_of(5), beta=0.0))
    for step in unblended:
        np.testing.assert_array_equal(*step.latents)


def test_one_branch_has_no_guidance():
    inputs = make_inputs(branches=1)
    first = last(shadow_guided(network, inputs, solver_of(5), gamma=1.0))
    np.testing.assert_array_equal(
        first, last(shadow_guided(network, inputs, solver_of(5), gamma=7.0))
    )
    assert first.shape == (1, *LATENT)


def test_one_noise_serves_all_steps():
    inputs = make_inputs()
    one = replace(inputs, step_noise=inputs.step_noise[:1])
    repeated = replace(inputs, step_noise=np.repeat(inputs.step_noise[:1], 4, axis=0))
    np.testing.assert_array_equal(
        last(shadow_guided(network, one, solver_of(5))),
        last(shadow_guided(network, repeated, solver_of(5))),
    )


@pytest.mark.parametrize("given", [0, 2, 3, 5])
def test_wrong_number_of_noises_is_not_made_up_for(given):
    inputs = replace(make_inputs(), step_noise=np.zeros((given, *LATENT), np.float32))
    with pytest.raises(ShapeError, match=f"step_noise: expected 1 or 4 arrays .* got {given}"):
        last(shadow_guided(network, inputs, solver_of(5)))


def test_noise_is_not_needed_where_nothing_is_blended():
    inputs = replace(make_inputs(), step_noise=np.zeros((0, *LATENT), np.float32))
    last(shadow_guided(network, inputs, solver_of(5), beta=0.0))
    last(shadow_guided(network, inputs, solver_of(1)))


def test_rescale_changes_the_object():
    inputs = make_inputs()
    plain = last(shadow_guided(network, inputs, solver_of(5), gamma=7.0))
    rescaled = last(shadow_guided(network, inputs, solver_of(5), gamma=7.0, guidance_rescale=1.0))
    assert not np.allclose(plain, rescaled)


def test_inputs_are_left_alone():
    inputs = make_inputs()
    for value in arrays_of(inputs).values():
        value.setflags(write=False)
    for name in ("ddim", "dpmpp_2m", "unipc"):
        last(shadow_guided(network, inputs, solver_of(5, name)))


@pytest.mark.parametrize("solver", ["ddim", "dpmpp_2m", "unipc"])
@pytest.mark.parametrize("fidelity", ["paper", "release"])
def test_lights_together_are_each_as_alone(solver, fidelity):
    def alike(z, timestep):
        return np.sin(2 * z + np.float32(1e-3 * timestep))

    def run(inputs):
        return last(
            shadow_guided(
                alike,
                inputs,
                solver_of(5, solver),
                gamma=5.0,
                beta=0.3,
                guidance_rescale=0.5,
                fidelity=fidelity,
                branches=lambda index: 2 if index in (1, 2) else 1,
            )
        )

    one = make_inputs()
    others = [arrays_of(make_inputs(seed=seed)) for seed in (1, 2)]
    shared = {n: getattr(one, n) for n in ("guidance_mask", "initial_noise", "step_noise")}
    three = [one, *(LoopInputs(**(other | shared)) for other in others)]
    together = run(LoopInputs.joined(three))
    for number, inputs in enumerate(three):
        np.testing.assert_array_equal(together[number::3], run(inputs))
    assert not np.array_equal(together[0], together[1])


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("composite_latents", (1, *LATENT)),
        ("composite_latents", (2, 4, 3, 6)),
        ("composite_latents", (2, 8, 3, 5)),
        ("shadow_mask", (2, 3, 5)),
        ("shadow_mask", (1, 1, 3, 5)),
        ("shadow_mask", (2, 4, 3, 5)),
        ("guidance_mask", (2, 1, 3, 5)),
        ("guidance_mask", (3, 5)),
        ("initial_noise", (2, *LATENT)),
        ("step_noise", LATENT),
        ("step_noise", (4, 4, 5, 3)),
        ("conditioning", (3, 11, 24, 40)),
        ("conditioning", (0, 11, 24, 40)),
    ],
)
def test_arrays_that_do_not_fit_together_are_named(name, shape):
    with pytest.raises(ShapeError, match=r"expected .*got"):
        replace(make_inputs(), **{name: np.zeros(shape, np.float32)})


def test_three_branches_are_named():
    inputs = make_inputs(branches=2)
    tripled = {
        name: np.repeat(getattr(inputs, name)[:1], 3, axis=0)
        for name in ("conditioning", "composite_latents", "shadow_mask")
    }
    with pytest.raises(ShapeError, match="conditioning: expected 1 or 2 branches a light, got 3"):
        replace(inputs, **tripled)
