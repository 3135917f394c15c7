"""What a graph is verified at: sizes, batches, timesteps; and what the reference says there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from spotlight_export.reference import DenoiserReference, VaeReference
from spotlight_export.trajectory import made_up_maps
from spotlight_spec import BackboneSpec

__all__ = ["Case", "Expectation", "cases", "expectation"]

Arrays = dict[str, npt.NDArray[Any]]

QUICK_SHAPES: Final = (((16, 24), 1), ((33, 47), 2))
FULL_SHAPES: Final = (
    *(((16, 24), batch) for batch in (1, 2, 3)),
    *(((33, 47), batch) for batch in (1, 2)),
    ((64, 64), 1),
)
"""Latent sizes and batches: not square, odd (every level of the UNet rounds), the trained one."""

TIMED_GRAPHS: Final = ("denoiser", "controlnet", "unet")


@dataclass(frozen=True, slots=True)
class Case:
    """Latent size, batch, and train timestep where the graph takes one."""

    size: tuple[int, int]
    batch: int
    timestep: int | None

    def __str__(self) -> str:
        timed = "" if self.timestep is None else f" · t {self.timestep}"
        return f"{self.size[0]}×{self.size[1]} · batch {self.batch}{timed}"


@dataclass(frozen=True, slots=True)
class Expectation:
    """A graph's inputs and what the published forward passes make of them."""

    graph: str
    case: Case
    inputs: Arrays
    outputs: Arrays


def cases(graph: str, spec: BackboneSpec, *, full: bool) -> Iterator[Case]:
    """Cases of one graph; timesteps are the first asked for (ᾱ = 0), a middle one and the last."""
    last = spec.schedule.num_train_timesteps - 1
    timesteps = (last, last // 2, 0) if full else (last, 0)
    for size, batch in FULL_SHAPES if full else QUICK_SHAPES:
        for timestep in timesteps if graph in TIMED_GRAPHS else (None,):
            yield Case(size, batch, timestep)


def expectation(
    graph: str,
    case: Case,
    spec: BackboneSpec,
    vae: VaeReference,
    denoiser: DenoiserReference,
    rng: np.random.Generator,
) -> Expectation:
    """Draw a graph's inputs and evaluate the reference on them."""
    latents = rng.standard_normal((case.batch, spec.latent.channels, *case.size), np.float32)
    if graph == "vae_encoder":
        height, width = (side * spec.latent.downscale for side in case.size)
        image = rng.uniform(-1, 1, (case.batch, 3, height, width)).astype(np.float32)
        return Expectation(graph, case, {"image": image}, vae.vae_encoder(image))
    if graph == "vae_decoder":
        return Expectation(graph, case, {"latents": latents}, vae.vae_decoder(latents))
    maps = made_up_maps(spec, case.size, case.batch, rng)
    condition = denoiser.condition_encoder(maps)
    if graph == "condition_encoder":
        return Expectation(graph, case, {"conditioning": maps}, condition)
    noisy = {"latents": latents, "timestep": np.array([case.timestep], np.int64)}
    if graph == "unet":
        inputs = noisy | denoiser.controlnet(**noisy, condition=maps)
        return Expectation(graph, case, inputs, denoiser.unet(**inputs))
    outputs = getattr(denoiser, graph)(**noisy, condition=maps)
    return Expectation(graph, case, noisy | condition, outputs)
