"""Same seed, same bytes: whatever order, memory or threads the work is done in."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from spotlight_runtime import Relighter

PICTURES = ("image", "prediction", "no_shadow")


def same_bytes(a, b):
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in PICTURES)


@pytest.mark.parametrize("fidelity", ["paper", "release"])
@pytest.mark.parametrize("solver", ["ddim", "unipc"])
def test_same_seed_same_bytes(relighter, options, scene, shadow, negative, fidelity, solver):
    chosen = replace(options, fidelity=fidelity, solver=solver)
    first = relighter.relight(scene, shadow, negative, chosen)
    assert same_bytes(first, relighter.relight(scene, shadow, negative, chosen))


def test_other_relights_between_change_nothing(relighter, options, scene, shadow, negative):
    first = relighter.relight(scene, shadow, negative, options)
    relighter.relight(scene, negative, None, replace(options, seed=5, steps=2))
    next(relighter.run(scene, negative, shadow, replace(options, seed=6)))
    assert same_bytes(first, relighter.relight(scene, shadow, negative, options))


def test_another_seed_is_another_picture(relighter, options, scene, shadow):
    a, b = (
        relighter.relight(scene, shadow, options=replace(options, seed=seed)) for seed in (1, 2)
    )
    assert np.abs(a.prediction - b.prediction).max() > 0.01


def test_seed_zero_is_a_seed(relighter, options, scene, shadow):
    a, b = (
        relighter.relight(scene, shadow, options=replace(options, seed=seed)) for seed in (0, 469)
    )
    assert not same_bytes(a, b)


@pytest.mark.parametrize("fidelity", ["paper", "release"])
def test_gamma_one_does_not_know_the_negative_shadow(
    relighter, options, scene, shadow, negative, fidelity
):
    chosen = replace(options, gamma=1.0, fidelity=fidelity)
    pictures = [
        relighter.relight(scene, shadow, other, chosen)
        for other in (None, negative, shadow, np.ones_like(shadow))
    ]
    assert all(same_bytes(pictures[0], other) for other in pictures[1:])


def test_another_gamma_does(relighter, options, scene, shadow, negative):
    pictures = [relighter.relight(scene, shadow, other, options) for other in (None, negative)]
    assert not same_bytes(*pictures)


def test_low_memory_gives_the_same_bytes(backbone, relighter, options, scene, shadow, negative):
    frugal = Relighter.load(backbone, threads=1, low_memory=True)
    wanted = relighter.relight(scene, shadow, negative, options)
    for _ in range(2):
        assert same_bytes(frugal.relight(scene, shadow, negative, options), wanted)
        assert frugal._networks._open == {}, "every session is closed once its stage is over"


def test_a_fresh_relighter_gives_the_same_bytes(backbone, relighter, options, scene, shadow):
    fresh = Relighter.load(backbone, threads=1)
    wanted = relighter.relight(scene, shadow, options=options)
    assert same_bytes(fresh.relight(scene, shadow, options=options), wanted)


def test_branches_apart_give_the_same_picture(relighter, options, scene, shadow, negative):
    apart = relighter.relight(scene, shadow, negative, options)
    together = relighter.relight(scene, shadow, negative, replace(options, batch_branches=True))
    np.testing.assert_allclose(apart.image, together.image, atol=1e-5)


@pytest.mark.parametrize("low_memory", [False, True])
def test_eight_threads_on_one_relighter(backbone, options, scene, shadow, negative, low_memory):
    shared = Relighter.load(backbone, threads=1, low_memory=low_memory, remember=0)
    chosen = [replace(options, seed=seed % 3) for seed in range(16)]
    with ThreadPoolExecutor(8) as pool:
        pictures = list(pool.map(lambda o: shared.relight(scene, shadow, negative, o), chosen))
    alone = [shared.relight(scene, shadow, negative, replace(options, seed=s)) for s in range(3)]
    for option, picture in zip(chosen, pictures):
        assert same_bytes(picture, alone[option.seed])


def test_two_runs_may_take_turns(relighter, options, scene, shadow, negative):
    """Generators of one relighter share nothing but its sessions."""
    runs = [relighter.run(scene, s, None, options) for s in (shadow, negative)]
    turns = [[], []]
    for _ in range(8):
        for run, seen in zip(runs, turns):
            seen.append(next(run).step.latents.tobytes())
    for s, seen in zip((shadow, negative), turns):
        alone = [p.step.latents.tobytes() for p in relighter.run(scene, s, None, options)]
        assert seen == alone


@pytest.mark.parametrize("pays", [False, True])
def test_branches_share_a_call_where_that_pays_for_the_backbone(
    backbone, options, scene, shadow, negative, pays
):
    loaded = Relighter.load(backbone, threads=1)
    relighter = Relighter(replace(loaded.spec, batch_branches=pays), loaded._networks)
    plan = relighter.relight(scene, shadow, negative, options).plan
    assert plan.calls()["denoiser"] == plan.evaluations - (plan.passes[0].contrasts if pays else 0)
    other = relighter.relight(scene, shadow, negative, options, batch_branches=not pays)
    assert other.plan.batched is not pays
