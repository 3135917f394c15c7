"""The arrays the runtime makes of a scene, against those the oracle makes of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from oracle.loop import Branch, Fidelity
from oracle.networks import Backbone

from spotlight_runtime import LoopInputs, Relighter, RelightOptions, Scene
from spotlight_runtime.diffusion.noise import gaussian
from spotlight_spec import BackboneSpec

from .bridge import object_on_latents, oracle_branch
from .measure import Tolerance, assert_within
from .shadows import NEGATIVES, Negative, wanted_shadow

SEED, STEPS = 11, 4


@pytest.fixture(params=["release", "paper"])
def fidelity(request: pytest.FixtureRequest) -> Fidelity:
    return request.param


@pytest.fixture(params=NEGATIVES)
def negative(request: pytest.FixtureRequest) -> Negative:
    return request.param


@pytest.fixture
def actual(
    relighter_over: Callable[[str], Relighter], scene: Scene, negative: Negative, fidelity: Fidelity
) -> LoopInputs:
    return relighter_over("torch").loop_inputs(
        scene,
        wanted_shadow(scene),
        None if negative == "none" else NEGATIVES[negative](scene),
        RelightOptions(seed=SEED, steps=STEPS, fidelity=fidelity),
    )


@pytest.fixture
def expected(
    backbone64: Backbone, spec: BackboneSpec, scene: Scene, negative: Negative, fidelity: Fidelity
) -> list[Branch]:
    """The oracle's branches; of the runtime it takes the posterior's draws only."""
    shadows = (wanted_shadow(scene), NEGATIVES[negative](scene))
    draws = [torch.from_numpy(gaussian(SEED, "posterior", (4, 8, 12), i)).double() for i in (0, 1)]
    return [
        oracle_branch(backbone64, spec, scene, shadow, draw if fidelity == "release" else None)
        for shadow, draw in zip(shadows, draws)
    ]


def test_conditioning(actual: LoopInputs, expected: list[Branch]) -> None:
    for ours, branch in zip(actual.conditioning, expected, strict=True):
        np.testing.assert_allclose(ours, branch.conditioning, rtol=2e-5, atol=1e-6)


def test_shadow_masks(actual: LoopInputs, expected: list[Branch]) -> None:
    for ours, branch in zip(actual.shadow_mask, expected, strict=True):
        np.testing.assert_array_equal(ours, branch.shadow_mask)


def test_guidance_mask(actual: LoopInputs, spec: BackboneSpec, scene: Scene) -> None:
    m_obj = object_on_latents(spec, scene)
    np.testing.assert_allclose(actual.guidance_mask[0], m_obj, rtol=1e-6, atol=1e-7)


def test_composite_latents(actual: LoopInputs, expected: list[Branch]) -> None:
    composites = torch.stack([branch.composite_latents for branch in expected])
    assert_within(Tolerance(1e-5, 1e-5), actual.composite_latents, composites)


def test_noise(actual: LoopInputs, fidelity: Fidelity) -> None:
    """Fresh noise for each blend as released; the first latents' own noise as the paper has it."""
    if fidelity == "release":
        drawn = np.concatenate([actual.initial_noise, actual.step_noise])
        assert drawn.shape == (STEPS, 4, 8, 12)
        assert len({draw.tobytes() for draw in drawn}) == STEPS
    else:
        np.testing.assert_array_equal(actual.step_noise, actual.initial_noise)
