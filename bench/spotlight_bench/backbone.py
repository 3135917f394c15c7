"""A backbone under evaluation, and the few steps of a relight the methods have in common."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from spotlight_runtime import LoopInputs, Relighter, RelightOptions, Scene, Step
from spotlight_runtime.arrays import BoolArray, FloatArray, pad_edge
from spotlight_runtime.codec import decode_latents
from spotlight_runtime.colour import decode_to_linear, encode_linear, linear_to_srgb
from spotlight_runtime.composite import compose_picture
from spotlight_runtime.conditioning import composite_maps
from spotlight_runtime.denoise import denoise, denoiser_available
from spotlight_runtime.models import open_networks, resolve_model
from spotlight_runtime.sessions import Network
from spotlight_spec import BackboneSpec

__all__ = ["Backbone", "cleared", "compose", "decode", "last", "one_branch"]


@dataclass(frozen=True, slots=True, eq=False)
class Backbone:
    """What the methods run on.

    Attributes
    ----------
    spec : BackboneSpec
    networks : mapping of str to Network
        Plain functions do.
    facts : dict
        What reports say about the model.
    """

    spec: BackboneSpec
    networks: Mapping[str, Network]
    facts: dict[str, Any] = field(default_factory=dict)

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

    @property
    def relighter(self) -> Relighter:
        """The runtime on these networks."""
        return Relighter(self.spec, self.networks, model=self.facts)


def cleared(shadow: FloatArray, padded: Scene) -> FloatArray:
    """The shadow grown to the padded scene and taken away under the object."""
    grown = np.clip(pad_edge(shadow, padded.size), 0.0, 1.0)
    return grown * (np.float32(1.0) - padded.object_mask)


def one_branch(inputs: LoopInputs) -> LoopInputs:
    """The positive branch alone: no guidance."""
    return replace(
        inputs,
        conditioning=inputs.conditioning[:1],
        composite_latents=inputs.composite_latents[:1],
        shadow_mask=inputs.shadow_mask[:1],
    )


def last(trajectory: Iterator[Step]) -> FloatArray:
    """Final latents of the positive branch, shape (1, C, h, w)."""
    (step,) = deque(trajectory, maxlen=1)
    return step.latents[:1]


def decode(
    backbone: Backbone, latents: FloatArray, padded: Scene, options: RelightOptions
) -> FloatArray:
    """Picture of latents as the runtime makes it: decoded, and denoised where the backbone wants.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        In the backbone's encoding.
    """
    picture = decode_latents(backbone.networks, backbone.spec, latents)
    wanted = backbone.spec.noisy_renders if options.denoise is None else options.denoise
    if not wanted or not (options.denoise or denoiser_available()):
        return picture
    encoding = backbone.spec.image_encoding
    maps = composite_maps(padded, tuple(n for n in ("albedo", "normal") if padded.has_map(n)))
    linear = decode_to_linear(picture, encoding)
    return encode_linear(denoise(linear, maps.get("albedo"), maps.get("normal")), encoding)


def compose(
    backbone: Backbone,
    padded: Scene,
    predicted: FloatArray,
    no_shadow: FloatArray,
    region: BoolArray | None,
) -> FloatArray:
    """Background preservation (method §5), sRGB-encoded; what is untouched stays exact.

    Parameters
    ----------
    backbone : Backbone
    padded : Scene
    predicted, no_shadow : ndarray of float32, shape (H, W, 3)
        As `decode` returns them.
    region : ndarray of bool, shape (H, W), or None
        Where the photograph may darken; None: everywhere.
    """
    encoding = backbone.spec.image_encoding
    photograph = np.clip(encode_linear(padded.background, encoding), 0.0, 1.0)
    composed, untouched = compose_picture(
        photograph, predicted, no_shadow, padded.object_mask, region
    )
    picture = linear_to_srgb(decode_to_linear(composed, encoding))
    return np.where(untouched[..., None], linear_to_srgb(padded.background), picture)
