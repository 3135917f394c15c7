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
from spotlight_runtime import RelightOptions, Scene
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.blending import add_noise
from spotlight_runtime.codec import encode_conditioning
from spotlight_runtime.conditioning import conditioning_array
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
    backbone: Backbone, view: Scene, shadow: FloatArray, options: RelightOptions
) -> FloatArray:
    """Final latents of the baseline.

    Parameters
    ----------
    backbone : Backbone
    view : Scene
        At the model's scale, as `Prepared` has it.
    shadow : ndarray of float32, shape (h, w)
        Guiding shadow of the view, cleared under the object.
    options : RelightOptions
        Seed, steps and solver apply.

    Returns
    -------
    ndarray of float32, shape (1, C, h, w)
    """
    spec, latent = backbone.spec, backbone.spec.latent
    shape = (1, latent.channels, *(side // latent.downscale for side in view.size))
    plain = conditioning_array(spec, view, np.zeros_like(shadow))
    schedule = Schedule.trailing(spec.schedule, options.steps_for(spec))

    def run(conditioning: FloatArray, latents: FloatArray, steps: Schedule) -> FloatArray:
        condition = encode_conditioning(backbone.networks, conditioning[None])
        predict = predictor(backbone.networks, condition, spec.schedule)
        return last(sample(predict, latents, make_solver(options.solver, steps)))

    shadowed = shadowed_shading(spec, plain, np.float32(options.shadow_opacity) * shadow)
    first = run(shadowed, gaussian(options.seed, "initial", shape), schedule)
    start = len(schedule) - steps_again(len(schedule))
    # The start's own noise would lead back to the start's own picture.
    noise = gaussian(options.seed, "step", shape)
    noised = add_noise(first, noise, float(schedule.alpha_bar[start])).astype(np.float32)
    rest = replace(
        schedule, timesteps=schedule.timesteps[start:], alpha_bar=schedule.alpha_bar[start:]
    )
    return run(hidden_everywhere(spec, plain), noised, rest)


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
    conditioning : ndarray of float32, shape (K, h, w)
    shadow : ndarray of float32, shape (h, w)

    Returns
    -------
    ndarray of float32, shape (K, h, w)
    """
    result = conditioning.copy()
    for entry, planes in _maps(spec, "shading"):
        known = conditioning[planes]
        darker = np.clip(known * (np.float32(1.0) - shadow), entry.minimum, entry.maximum)
        result[planes] = np.where(known == np.float32(_fill(entry)), known, darker)
    return result


def hidden_everywhere(spec: BackboneSpec, conditioning: FloatArray) -> FloatArray:
    """Conditioning, shape (K, h, w), with the shading of the whole picture hidden."""
    result = conditioning.copy()
    for name in ("shading", "mask"):
        for entry, planes in _maps(spec, name):
            result[planes] = np.float32(_fill(entry))
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
