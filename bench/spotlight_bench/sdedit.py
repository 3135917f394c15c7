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

from spotlight_bench.backbone import Backbone, compose_everywhere, decode, last
from spotlight_runtime import GuidingShadow, LoopInputs, RelightOptions, Scene
from spotlight_runtime.arrays import FloatArray, pad_edge
from spotlight_runtime.diffusion.blending import add_noise
from spotlight_runtime.diffusion.noise import gaussian
from spotlight_runtime.diffusion.sampler import sample
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import make_solver
from spotlight_runtime.networks.codec import encode_conditioning
from spotlight_runtime.networks.models import predictor
from spotlight_spec import BackboneSpec, MapSpec

__all__ = ["hidden_everywhere", "one_branch", "sdedit_picture", "shadowed_shading", "steps_again"]

NOISED_SHARE: Final = 0.5
"""Of the steps; the paper's."""


def sdedit_picture(
    backbone: Backbone, scene: Scene, shadow: FloatArray, options: RelightOptions
) -> FloatArray:
    """Picture of the baseline, made of the whole photograph at its own scale.

    The photograph may darken wherever the shading was hidden, as in ZeroComp: here, everywhere.

    Parameters
    ----------
    backbone : Backbone
    scene : Scene
    shadow : ndarray of float32, shape (H, W)
        Guiding shadow.
    options : RelightOptions
        Seed, steps, solver, shadow opacity and denoising apply.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        sRGB-encoded, in [0, 1].
    """
    spec, relighter = backbone.spec, backbone.relighter
    padded = scene.padded(spec.latent.downscale)
    alone = replace(options, gamma=1.0, beta=0.0, window="frame")
    none = GuidingShadow(np.zeros_like(shadow))
    plain = one_branch(relighter.loop_inputs(scene, none, options=alone))
    no_shadow = decode(backbone, last(relighter.trajectory(plain, alone)), padded, options)

    opaque = np.float32(options.shadow_opacity) * pad_edge(shadow, padded.size)
    cast = np.clip(opaque, 0.0, 1.0) * (np.float32(1.0) - padded.object_mask)
    shadowed = replace(plain, conditioning=shadowed_shading(spec, plain.conditioning, cast))
    first = last(relighter.trajectory(shadowed, alone))
    latents = _again(backbone, first, hidden_everywhere(spec, plain.conditioning), options)
    predicted = decode(backbone, latents, padded, options)
    picture = compose_everywhere(backbone, padded, predicted, no_shadow)
    return np.ascontiguousarray(picture[: scene.size[0], : scene.size[1]])


def one_branch(inputs: LoopInputs) -> LoopInputs:
    """The positive branch alone: no guidance."""
    return replace(
        inputs,
        conditioning=inputs.conditioning[:1],
        composite_latents=inputs.composite_latents[:1],
        shadow_mask=inputs.shadow_mask[:1],
    )


def _again(
    backbone: Backbone, latents: FloatArray, conditioning: FloatArray, options: RelightOptions
) -> FloatArray:
    """Noise latents by the baseline's share of the steps, and denoise them on a conditioning."""
    networks, spec = backbone.remembering, backbone.spec
    schedule = Schedule.trailing(spec.schedule, options.steps_for(spec))
    start = len(schedule) - steps_again(len(schedule))
    # The start's own noise would lead back to the start's own picture.
    noise = gaussian(options.seed, "step", latents.shape)
    noised = add_noise(latents, noise, float(schedule.alpha_bar[start])).astype(np.float32)
    rest = replace(
        schedule, timesteps=schedule.timesteps[start:], alpha_bar=schedule.alpha_bar[start:]
    )
    predict = predictor(networks, encode_conditioning(networks, conditioning), spec.schedule)
    return last(sample(predict, noised, make_solver(options.solver, rest)))


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
    for entry in spec.maps:
        if entry.name == name:
            yield entry, spec.channels[name]


def _fill(entry: MapSpec) -> float:
    return entry.minimum if entry.fill is None else entry.fill
