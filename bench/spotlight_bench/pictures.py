"""Pictures of one scene by every method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from spotlight_bench.backbone import Backbone
from spotlight_bench.dataset import Direction, TestScene
from spotlight_bench.errors import DataError, MethodError
from spotlight_bench.methods import Method
from spotlight_bench.sdedit import sdedit_picture, steps_again
from spotlight_runtime import GuidingShadow, RelightOptions, RelightResult, Scene, read_image
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.conditioning import over
from spotlight_runtime.imaging.colour import linear_to_srgb

__all__ = ["Made", "Studio", "foreign_file", "pasted_object"]

_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".exr")
_WITHOUT_NETWORK: Final = ("pasted", "folder")
DARKEST_ALBEDO: Final = 1e-3
"""A background whose mean albedo is below this says nothing about its light."""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A picture, and what it took.

    Attributes
    ----------
    image : ndarray of float32, shape (H, W, 3)
        sRGB-encoded, in [0, 1].
    evaluations : int
        Of the denoiser, without those of the picture without a shadow.
    """

    image: FloatArray
    evaluations: int = 0


class Studio:
    """Makes the pictures of one scene.

    Parameters
    ----------
    backbone : Backbone
        It forgets what it remembers of the scene before.
    test : TestScene
    options : RelightOptions
        Seed, steps, solver, fidelity, window and denoising; γ and β are the method's, and what
        its plan says of the others goes before them.
    """

    def __init__(self, backbone: Backbone, test: TestScene, options: RelightOptions) -> None:
        backbone.memory.clear()
        self._backbone = backbone
        self._test = test
        self._options = options

    def prepare(self, methods: Sequence[Method]) -> None:
        """Make what these methods share, so that it is not counted to the first of them."""
        if any(method.kind not in _WITHOUT_NETWORK for method in methods):
            self._without_control()

    def picture(self, method: Method, direction: Direction) -> Made:
        """Make the picture of a method.

        Raises
        ------
        DataError
            If the method needs the opposite shadow and the set has none.
        MethodError
            If another method's picture is missing or of another size.
        SpotLightError
            As a relight does.
        """
        scene = self._test.scene
        if method.kind == "folder":
            return Made(_foreign_picture(method, self._test, direction))
        if method.kind == "pasted":
            return Made(pasted_object(scene))
        if method.kind == "no-control":
            return Made(self._without_control().image)
        if method.kind == "sdedit":
            image = sdedit_picture(self._backbone, scene, direction.shadow, self._options)
            steps = self._options.steps_for(self._backbone.spec)
            return Made(image, steps + steps_again(steps))
        result = self._spotlight(method, direction)
        return Made(result.image, sum(each.evaluations for each in result.plan.passes))

    def _spotlight(self, method: Method, direction: Direction) -> RelightResult:
        negative = direction.opposite if method.negative == "opposite" else None
        if method.negative == "opposite" and negative is None:
            raise DataError(
                f"{self._test.folder}: expected shadow_negative_{direction.name}.png for method "
                f"{method.name}, found none; add it or evaluate --methods negative-none"
            )
        seed = self._options.seed if method.seed is None else method.seed
        options = replace(self._options, gamma=method.gamma, beta=method.beta, seed=seed)
        guide = GuidingShadow(direction.shadow, negative)
        return self._backbone.relighter.relight(
            self._test.scene, guide, options=options, plan=method.plan
        )

    def _without_control(self) -> RelightResult:
        """The renderer alone: without a shadow, both branches are the picture without one."""
        none = GuidingShadow(np.zeros(self._test.scene.size, np.float32))
        options = replace(self._options, gamma=1.0, beta=0.0)
        return self._backbone.relighter.relight(self._test.scene, none, options=options)


def pasted_object(scene: Scene) -> FloatArray:
    """The object's albedo under flat light, over the photograph as it is; sRGB-encoded.

    The light's colour is the mean of the photograph over the mean of its albedo.
    """
    bright = scene.background.mean(axis=(0, 1), dtype=np.float64)
    albedo = scene.background_maps.albedo.mean(axis=(0, 1), dtype=np.float64)
    light = (bright / np.maximum(albedo, DARKEST_ALBEDO)).astype(np.float32)
    return linear_to_srgb(
        over(scene.object_maps.albedo * light, scene.object_mask, scene.background)
    )


def foreign_file(method: Method, scene: str, direction: str) -> Path | None:
    """Picture of another method: ``SCENE/DIRECTION.png`` or ``SCENE_DIRECTION.png``, or None.

    Also JPEG, WebP and (linear) EXR.
    """
    folder = Path(method.folder)
    for stem in (folder / scene / direction, folder / f"{scene}_{direction}"):
        for suffix in _SUFFIXES:
            path = stem.parent / f"{stem.name}{suffix}"
            if path.is_file():
                return path
    return None


def _foreign_picture(method: Method, test: TestScene, direction: Direction) -> FloatArray:
    path = foreign_file(method, test.name, direction.name)
    if path is None:
        raise MethodError(
            f"method {method.name}: expected {method.folder}/{test.name}/{direction.name}.png, "
            "found no such picture"
        )
    pixels = read_image(path)
    if pixels.ndim != 3 or pixels.shape[:2] != test.scene.size or pixels.shape[2] < 3:
        raise MethodError(
            f"method {method.name}: expected RGB of {test.scene.size[1]}x{test.scene.size[0]} "
            f"pixels in {path}, got shape {pixels.shape}; resize it to the scene's size"
        )
    colour = np.ascontiguousarray(pixels[..., :3])
    return linear_to_srgb(colour) if path.suffix == ".exr" else np.clip(colour, 0.0, 1.0)
