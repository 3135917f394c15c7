"""A backbone under evaluation, and what all methods make pictures of and with."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spotlight_runtime import RelightOptions, Step, passes
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.mixing import Mix, put_back
from spotlight_runtime.models import open_networks, resolve_model
from spotlight_runtime.preparation import Prepared
from spotlight_runtime.result import Stopwatch
from spotlight_runtime.sampler import Fidelity
from spotlight_runtime.scene import Scene
from spotlight_runtime.sessions import Network
from spotlight_spec import BackboneSpec

__all__ = ["Backbone", "compose", "develop", "last"]


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


def last(trajectory: Iterator[Step]) -> FloatArray:
    """Final latents of the positive branch, shape (1, C, h, w)."""
    (step,) = deque(trajectory, maxlen=1)
    return step.latents[:1]


def develop(
    backbone: Backbone, view: Scene, latents: FloatArray, options: RelightOptions
) -> FloatArray:
    """From final latents to a picture in the backbone's encoding, denoised as a relight would."""
    denoised = passes.denoising(backbone.spec, options) == "on"
    spec, networks = backbone.spec, backbone.networks
    return passes.develop(networks, spec, view, latents, denoised, Stopwatch())


def compose(
    backbone: Backbone,
    prepared: Prepared,
    predicted: FloatArray,
    no_shadow: FloatArray,
    fidelity: Fidelity,
) -> FloatArray:
    """Put a prediction back into the photograph as a relight does.

    Parameters
    ----------
    backbone : Backbone
    prepared : Prepared
        Of one light.
    predicted, no_shadow : ndarray of float32, shape (h, w, 3)
        As `develop` returns them.
    fidelity : {"paper", "release"}
        The photograph may darken in the shadow's region only, or everywhere.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        sRGB-encoded, in [0, 1].
    """
    layer = passes.layer(backbone.spec, prepared, 0, predicted, no_shadow, fidelity)
    return put_back(prepared.scene, prepared.window, [layer], Mix.of(prepared.guides))
