"""ZeroComp+SDEdit, the paper's shadow-conditioned baseline (method §8).

First the renderer alone, its shading hidden under the object and the guiding shadow composited into
the background's shading. Then half of the noise again, and the remaining half of the steps with the
shading of the whole picture hidden, which blends the shadow in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from spotlight_bench.backbone import Backbone, last
from spotlight_runtime import LoopInputs, RelightOptions
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.blending import add_noise
from spotlight_runtime.codec import encode_conditioning
from spotlight_runtime.models import predictor
from spotlight_runtime.noise import gaussian
from spotlight_runtime.sampler import sample
from spotlight_runtime.schedule import Schedule
from spotlight_runtime.solvers import make_solver
from spotlight_spec import BackboneSpec, MapSpec

__all__ = ["hidden_everywhere", "sdedit_latents", "shadowed_shading", "steps_again"]

NOISED_SHARE: Final = 0.5
"""Of the steps; the paper's."""


def sdedit_latents(
    backbone: Backbone, inputs: LoopInputs, shadow: FloatArray, options: RelightOptions
) -> FloatArray:
    """Final latents of the baseline.

    Parameters
    ----------
    backbone : Backbone
    inputs : LoopInputs
        Of the renderer alone: one branch, shading hidden under the object only.
    shadow : ndarray of float32, shape (H, W)
        Guiding shadow, cleared under the object.
    options : RelightOptions
        Seed, steps and solver apply.

    Returns
    -------
    ndarray of float32, shape (1, C, h, w)
    """
    spec = backbone.spec
    opaque = np.float32(options.shadow_opacity) * shadow
    first = replace(inputs, conditioning=shadowed_shading(spec, inputs.conditioning, opaque))
    unguided = replace(options, beta=0.0)
    latents = last(backbone.relighter.trajectory(first, unguided))

    schedule = Schedule.trailing(spec.schedule, options.steps_for(spec))
    start = len(schedule) - steps_again(len(schedule))
    # The start's own noise would lead back to the start's own picture.
    noise = gaussian(options.seed, "step", inputs.initial_noise.shape)
    noised = add_noise(latents, noise, float(schedule.alpha_bar[start]))
    rest = replace(
        schedule, timesteps=schedule.timesteps[start:], alpha_bar=schedule.alpha_bar[start:]
    )
    blind = hidden_everywhere(spec, inputs.conditioning)
    predict = predictor(
        backbone.networks, encode_conditioning(backbone.networks, blind), spec.schedule
    )
    return last(sample(predict, noised.astype(np.float32), make_solver(options.solver, rest)))


def steps_again(steps: int) -> int:
    """How many of the steps are run a second time."""
    return max(1, round(NOISED_SHARE * steps))


def shadowed_shading(
    spec: BackboneSpec, conditioning: FloatArray, shadow: FloatArray
) -> FloatArray:
    """Conditioning with the shadow composited into the shading where that is known.

    Parameters
    ----------
    spec : BackboneSpec
    conditioning : ndarray of float32, shape (1, K, H, W)
    shadow : ndarray of float32, shape (H, W)

    Returns
    -------
    ndarray of float32, shape (1, K, H, W)
    """
    result = conditioning.copy()
    for entry, planes in _maps(spec, "shading"):
        known = conditioning[:, planes]
        darker = np.clip(known * (np.float32(1.0) - shadow), entry.minimum, entry.maximum)
        result[:, planes] = np.where(known == np.float32(_fill(entry)), known, darker)
    return result


def hidden_everywhere(spec: BackboneSpec, conditioning: FloatArray) -> FloatArray:
    """Conditioning, shape (1, K, H, W), with the shading of the whole picture hidden."""
    result = conditioning.copy()
    for name in ("shading", "mask"):
        for entry, planes in _maps(spec, name):
            result[:, planes] = np.float32(_fill(entry))
    return result


def _maps(spec: BackboneSpec, name: str) -> Iterator[tuple[MapSpec, slice]]:
    """Yield the maps of that name (one or none) with their channels."""
    start = 0
    for entry in spec.maps:
        if entry.name == name:
            yield entry, slice(start, start + entry.channels)
        start += entry.channels


def _fill(entry: MapSpec) -> float:
    return entry.minimum if entry.fill is None else entry.fill
