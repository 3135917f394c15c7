"""SpotLight's own loop over any networks: what models are calibrated on and verified with.

This is the one place where the exporter uses the runtime: a loop written twice would verify a
computation that nobody runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from spotlight_runtime.diffusion.sampler import LoopInputs, shadow_guided
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import DDIM
from spotlight_runtime.networks.models import predictor
from spotlight_spec import BackboneSpec

__all__ = ["made_up_inputs", "made_up_maps", "run_loop"]

FloatArray = npt.NDArray[np.floating[Any]]
Networks = Mapping[str, Callable[..., dict[str, npt.NDArray[Any]]]]


def made_up_maps(
    spec: BackboneSpec, size: tuple[int, int], batch: int, rng: np.random.Generator
) -> FloatArray:
    """Conditioning maps that look like a backbone's: smooth, in range, masked in a rectangle.

    Parameters
    ----------
    spec : BackboneSpec
    size : tuple of int
        Latent height and width.
    batch : int
    rng : Generator

    Returns
    -------
    ndarray of float32, shape (batch, channels, height · downscale, width · downscale)
    """
    height, width = (side * spec.latent.downscale for side in size)
    top, left = height // 4, width // 3
    maps = []
    for entry in spec.maps:
        # Shading may reach 1000 but is a quotient of images, so it lives near 1.
        low, high = entry.minimum, min(entry.maximum, 20.0 if entry.name == "depth" else 2.0)
        values = low + (high - low) * _smooth(rng, (batch, entry.channels, height, width))
        if entry.name == "mask":
            values[:] = entry.maximum
        if entry.fill is not None:
            values[:, :, top : top + height // 3, left : left + width // 3] = entry.fill
        maps.append(values)
    return np.concatenate(maps, axis=1).astype(np.float32)


def made_up_inputs(
    spec: BackboneSpec, size: tuple[int, int], rng: np.random.Generator
) -> LoopInputs:
    """Two branches' inputs of a relight at a latent size."""
    shape = (spec.latent.channels, *size)
    mask = np.zeros((2, 1, *size), np.float32)
    for branch, column in enumerate((0, size[1] // 2)):
        mask[branch, :, size[0] // 2 :, column : column + size[1] // 2] = 1.0
    guidance = _smooth(rng, (1, 1, *size)).astype(np.float32)
    return LoopInputs(
        conditioning=made_up_maps(spec, size, 2, rng),
        composite_latents=rng.standard_normal((2, *shape), np.float32),
        shadow_mask=mask,
        guidance_mask=guidance,
        initial_noise=rng.standard_normal((1, *shape), np.float32),
        step_noise=rng.standard_normal((1, *shape), np.float32),
    )


def run_loop(
    networks: Networks,
    condition: FloatArray,
    inputs: LoopInputs,
    spec: BackboneSpec,
    *,
    reuse: int = 1,
) -> FloatArray:
    """Latents after all steps of a relight.

    Parameters
    ----------
    networks : mapping of str to callable
        With ``denoiser``, or with ``controlnet`` and ``unet``.
    condition : ndarray
        Whatever those networks take as ``condition``, one a branch.
    inputs : LoopInputs
    spec : BackboneSpec
    reuse : int
        As `predictor` takes it.

    Returns
    -------
    ndarray of float32, shape (2, channels, height, width)
    """
    predict = predictor(networks, condition, spec.schedule, reuse=reuse)
    solver = DDIM(Schedule.trailing(spec.schedule, spec.schedule.steps))
    *_, last = shadow_guided(predict, inputs, solver)
    return last.latents


def _smooth(rng: np.random.Generator, shape: tuple[int, int, int, int]) -> FloatArray:
    """Random fields in [0, 1] that vary over a quarter of the image."""
    batch, channels, height, width = shape
    knots = rng.random((batch, channels, 5, 5))
    rows, columns = (np.linspace(0, 4, side) for side in (height, width))
    weights = [
        np.maximum(0.0, 1.0 - np.abs(axis[:, None] - np.arange(5))) for axis in (rows, columns)
    ]
    fields: FloatArray = np.einsum("bcij,hi,wj->bchw", knots, *weights, optimize=True)
    return fields
