"""`Relighter.relight` against the oracle, from the maps of a scene to the picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from oracle import conditioning as method
from oracle.composite import composited, displayed
from oracle.loop import Draws, Fidelity, Knobs, renderer_alone, spotlight
from oracle.networks import Backbone
from oracle.schedule import scaled_linear_alpha_bar, trailing_timesteps, zero_terminal_snr
from torch import Tensor

from spotlight_runtime import LoopInputs, Relighter, RelightOptions, Scene
from spotlight_spec import BackboneSpec

from .bridge import (
    array,
    background_of,
    conditioning_of,
    object_on_latents,
    oracle_branch,
    tensor,
)
from .measure import Tolerance, assert_within
from .shadows import NEGATIVES, wanted_shadow

STEPS = 5
TIMESTEPS = trailing_timesteps(STEPS)
ALPHA_BAR = zero_terminal_snr(scaled_linear_alpha_bar())


def predictions(
    backbone: Backbone, spec: BackboneSpec, scene: Scene, drawn: LoopInputs, fidelity: Fidelity
) -> tuple[Tensor, Tensor]:
    """Both of the oracle's pictures, with and without the shadow, in [0, 1].

    The runtime's random arrays are taken over, and its composite latents, which hold a draw too.
    """
    shadows = (wanted_shadow(scene), NEGATIVES["opposite"](scene))
    positive, negative = (
        replace(
            oracle_branch(backbone, spec, scene, shadow, None),
            composite_latents=torch.from_numpy(z).double(),
        )
        for shadow, z in zip(shadows, drawn.composite_latents)
    )
    initial = torch.from_numpy(drawn.initial_noise[0]).double()
    # As much shadow in these steps as in the backbone's own; the release does not ask how many.
    every = (spec.schedule.steps - 1) / (STEPS - 1)
    beta = 0.05 if fidelity == "release" else 1.0 - 0.95**every
    blends = list(torch.from_numpy(drawn.step_noise).double())
    history = spotlight(
        backbone.predict,
        positive,
        negative,
        object_on_latents(spec, scene),
        Draws(initial, blends),
        TIMESTEPS,
        ALPHA_BAR,
        ALPHA_BAR[0],
        Knobs(beta=beta, fidelity=fidelity),
    )
    unshadowed = conditioning_of(spec, scene, torch.zeros_like(tensor(scene.object_mask)))
    plain = renderer_alone(
        backbone.predict, unshadowed, initial, TIMESTEPS, ALPHA_BAR, ALPHA_BAR[0]
    )
    predicted, no_shadow = (
        (0.5 * backbone.decoded(z) + 0.5).clamp(0.0, 1.0) for z in (history[-1][0], plain)
    )
    return predicted, no_shadow


@pytest.mark.parametrize("fidelity", ["release", "paper"])
def test_the_picture(
    relighter_over: Callable[[str], Relighter],
    backbone64: Backbone,
    spec: BackboneSpec,
    scene: Scene,
    fidelity: Fidelity,
) -> None:
    shadow, negative = wanted_shadow(scene), NEGATIVES["opposite"](scene)
    options = RelightOptions(steps=STEPS, fidelity=fidelity, denoise=False)
    relighter = relighter_over("torch")
    drawn = relighter.loop_inputs(scene, shadow, negative, options)
    predicted, no_shadow = predictions(backbone64, spec, scene, drawn, fidelity)
    alpha = tensor(scene.object_mask)
    region = method.masked_region(method.guiding_shadow(tensor(shadow), alpha), alpha)
    expected = composited(
        predicted,
        no_shadow,
        background_of(scene),
        alpha,
        region.double() if fidelity == "paper" else None,
    )
    result = relighter.relight(scene, shadow, negative, options)
    within = Tolerance(relative=1e-4, absolute=1e-4)
    assert_within(within, result.prediction, array(displayed(predicted)), "prediction")
    assert_within(within, result.no_shadow, array(displayed(no_shadow)), "no shadow")
    assert_within(within, result.image, array(displayed(expected)), "picture")
    assert np.abs(result.image - result.prediction).max() > 0.1
