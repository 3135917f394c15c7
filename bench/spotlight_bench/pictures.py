"""Pictures of one scene by every method, computing once what methods share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from spotlight_bench.backbone import Backbone, cleared, compose, decode, last, one_branch
from spotlight_bench.dataset import Direction, TestScene
from spotlight_bench.errors import DataError, MethodError
from spotlight_bench.methods import Method
from spotlight_bench.sdedit import sdedit_latents, steps_again
from spotlight_runtime import LoopInputs, RelightOptions, Scene, read_image
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.colour import linear_to_srgb
from spotlight_runtime.conditioning import masked_region, over

__all__ = ["Studio", "foreign_file", "pasted_object"]

_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".exr")
DARKEST_ALBEDO: Final = 1e-3
"""A background whose mean albedo is below this says nothing about its light."""


class Studio:
    """Makes the pictures of one scene.

    The renderer's picture without a shadow (it belongs to the seed, not to the direction) is made
    once for all methods and directions, the loop's inputs once for all γ and β of a direction.

    Parameters
    ----------
    backbone : Backbone
    test : TestScene
    options : RelightOptions
        Seed, steps, solver, fidelity and denoising; γ and β are the method's.
    """

    def __init__(self, backbone: Backbone, test: TestScene, options: RelightOptions) -> None:
        self._backbone = backbone
        self._test = test
        self._options = options
        self._padded = test.scene.padded(backbone.spec.latent.downscale)
        self._guided: tuple[str, str, LoopInputs] | None = None

    def prepare(self, methods: Sequence[Method]) -> None:
        """Make what these methods share, so that it is not counted to the first of them."""
        if any(method.kind not in ("pasted", "folder") for method in methods):
            _ = self._no_shadow

    def picture(self, method: Method, direction: Direction) -> FloatArray:
        """Picture of a method: sRGB-encoded, in [0, 1], float32, shape (H, W, 3).

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
            return _foreign_picture(method, self._test, direction)
        if method.kind == "pasted":
            return pasted_object(scene)
        shadow = cleared(direction.shadow, self._padded)
        if method.kind == "no-control":
            predicted, region = (
                self._no_shadow,
                masked_region(0.0 * shadow, self._padded.object_mask),
            )
        elif method.kind == "sdedit":
            latents = sdedit_latents(self._backbone, self._alone, shadow, self._options)
            # ZeroComp's ratio applies where the shading was hidden: here, everywhere.
            predicted, region = self._decoded(latents), None
        else:
            predicted = self._decoded(self._spotlight(method, direction))
            region = masked_region(shadow, self._padded.object_mask)
            region = region if self._options.fidelity == "paper" else None
        picture = compose(self._backbone, self._padded, predicted, self._no_shadow, region)
        return np.ascontiguousarray(picture[: scene.size[0], : scene.size[1]])

    def evaluations(self, method: Method) -> int:
        """Denoiser evaluations of one picture, without those of the shared one."""
        steps = self._options.steps_for(self._backbone.spec)
        if method.kind == "sdedit":
            return steps + steps_again(steps)
        return steps * method.branches if method.kind == "spotlight" else 0

    @cached_property
    def _alone(self) -> LoopInputs:
        """Inputs of the renderer without a shadow."""
        none = np.zeros(self._test.scene.size, np.float32)
        return one_branch(self._inputs(none, None))

    @cached_property
    def _no_shadow(self) -> FloatArray:
        unguided = replace(self._options, beta=0.0)
        return self._decoded(last(self._backbone.relighter.trajectory(self._alone, unguided)))

    def _spotlight(self, method: Method, direction: Direction) -> FloatArray:
        if method.negative == "opposite" and direction.opposite is None:
            raise DataError(
                f"{self._test.folder}: expected shadow_negative_{direction.name}.png for method "
                f"{method.name}, found none; add it or evaluate --methods negative-none"
            )
        inputs = self._guided_inputs(method, direction)
        options = replace(self._options, gamma=method.gamma, beta=method.beta)
        inputs = inputs if method.branches == 2 else one_branch(inputs)
        return last(self._backbone.relighter.trajectory(inputs, options))

    def _guided_inputs(self, method: Method, direction: Direction) -> LoopInputs:
        wanted = (direction.name, method.negative)
        if self._guided is None or self._guided[:2] != wanted:
            negative = direction.opposite if method.negative == "opposite" else None
            self._guided = (*wanted, self._inputs(direction.shadow, negative))
        return self._guided[2]

    def _inputs(self, shadow: FloatArray, negative: FloatArray | None) -> LoopInputs:
        return self._backbone.relighter.loop_inputs(
            self._test.scene, shadow, negative, self._options
        )

    def _decoded(self, latents: FloatArray) -> FloatArray:
        return decode(self._backbone, latents, self._padded, self._options)


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
