"""A backbone under evaluation, and a whole picture's way from latents into the photograph."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from spotlight_bench.remembered import Memory
from spotlight_runtime import Relighter, RelightOptions, Scene, Step
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.conditioning import composite_maps
from spotlight_runtime.imaging.colour import decode_to_linear, encode_linear, linear_to_srgb
from spotlight_runtime.imaging.denoise import denoise, denoiser_available
from spotlight_runtime.networks.codec import decode_latents
from spotlight_runtime.networks.models import open_networks, resolve_model
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.relighting.composite import compose_picture
from spotlight_spec import BackboneSpec

__all__ = ["Backbone", "compose_everywhere", "decode", "last"]


@dataclass(frozen=True, eq=False)
class Backbone:
    """What the methods run on.

    Attributes
    ----------
    spec : BackboneSpec
    networks : mapping of str to Network
        Plain functions do.
    facts : dict
        What reports say about the model.
    memory : Memory
        Of what the networks answered.
    """

    spec: BackboneSpec
    networks: Mapping[str, Network]
    facts: dict[str, Any] = field(default_factory=dict)
    memory: Memory = field(default_factory=Memory)

    @classmethod
    def load(cls, model: str | Path, threads: int | None = None) -> Backbone:
        """Open a model by name or folder.

        Raises
        ------
        ModelError
            If it is unknown or damaged.
        """
        folder = resolve_model(model)
        networks = open_networks(folder, threads=threads)
        return cls(folder.manifest.backbone, networks, folder.summary())

    @cached_property
    def remembering(self) -> dict[str, Network]:
        """The networks, asked but once for the same."""
        return self.memory.networks(self.networks)

    @cached_property
    def relighter(self) -> Relighter:
        """The runtime on these networks."""
        return Relighter(self.spec, self.remembering, model=self.facts)


def last(trajectory: Iterator[Step]) -> FloatArray:
    """Final latents of the positive branch, shape (1, C, h, w)."""
    (step,) = deque(trajectory, maxlen=1)
    return step.latents[:1]


def decode(
    backbone: Backbone, latents: FloatArray, padded: Scene, options: RelightOptions
) -> FloatArray:
    """Picture of latents, denoised where the backbone wants it, as the runtime makes it.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        In the backbone's encoding.
    """
    picture = decode_latents(backbone.remembering, backbone.spec, latents)
    wanted = backbone.spec.noisy_renders and denoiser_available()
    if not (wanted if options.denoise is None else options.denoise):
        return picture
    encoding = backbone.spec.image_encoding
    maps = composite_maps(padded, tuple(n for n in ("albedo", "normal") if padded.has_map(n)))
    clean = denoise(decode_to_linear(picture, encoding), maps.get("albedo"), maps.get("normal"))
    return encode_linear(clean, encoding)


def compose_everywhere(
    backbone: Backbone, padded: Scene, predicted: FloatArray, no_shadow: FloatArray
) -> FloatArray:
    """Background preservation (method §5) of a whole picture that may darken everywhere.

    Parameters
    ----------
    backbone : Backbone
    padded : Scene
    predicted, no_shadow : ndarray of float32, shape (H, W, 3)
        As `decode` returns them.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        sRGB-encoded; what is untouched is the photograph's, exactly.
    """
    encoding = backbone.spec.image_encoding
    photograph = np.clip(encode_linear(padded.background, encoding), 0.0, 1.0)
    composed, untouched = compose_picture(
        photograph, predicted, no_shadow, padded.object_mask, None
    )
    picture = linear_to_srgb(decode_to_linear(composed, encoding))
    return np.where(untouched[..., None], linear_to_srgb(padded.background), picture)
