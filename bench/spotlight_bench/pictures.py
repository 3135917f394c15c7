"""Pictures of one scene by every method, computing once what methods share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from spotlight_bench.backbone import Backbone, compose, develop, last
from spotlight_bench.dataset import Direction, TestScene
from spotlight_bench.errors import DataError, MethodError
from spotlight_bench.methods import Method
from spotlight_bench.sdedit import sdedit_latents, steps_again
from spotlight_runtime import (
    GuidingShadow,
    LoopInputs,
    RelightOptions,
    Scene,
    Window,
    passes,
    read_image,
)
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.colour import linear_to_srgb
from spotlight_runtime.conditioning import over
from spotlight_runtime.noise import gaussian
from spotlight_runtime.preparation import Prepared, loop_inputs, prepare_window

__all__ = ["Studio", "foreign_file", "pasted_object"]

_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".exr")
_WITHOUT_NETWORK: Final = ("pasted", "folder")
DARKEST_ALBEDO: Final = 1e-3
"""A background whose mean albedo is below this says nothing about its light."""


class Studio:
    """Makes the pictures of one scene; SpotLight's are those of `Relighter.relight`.

    The renderer's picture without a shadow is made once for all methods and directions that share
    a window (all of them, where the photograph is no larger than the backbone was trained at), the
    loop's inputs once for all γ and β of a direction.

    Parameters
    ----------
    backbone : Backbone
    test : TestScene
    options : RelightOptions
        Seed, steps, solver, fidelity, window and denoising; γ and β are the method's.
    """

    def __init__(self, backbone: Backbone, test: TestScene, options: RelightOptions) -> None:
        self._backbone = backbone
        self._test = test
        self._options = options
        self._plain: dict[Window, FloatArray] = {}
        self._guided: tuple[tuple[str, str], LoopInputs] | None = None

    def prepare(self, methods: Sequence[Method], direction: Direction) -> None:
        """Make what these methods share, so that it is not counted to the first of them."""
        for method in methods:
            if method.kind not in _WITHOUT_NETWORK:
                self._no_shadow(self._prepared(method, direction))

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
        if method.kind == "folder":
            return _foreign_picture(method, self._test, direction)
        if method.kind == "pasted":
            return pasted_object(self._test.scene)
        prepared, fidelity = self._prepared(method, direction), self._options.fidelity
        no_shadow = self._no_shadow(prepared)
        if method.kind == "no-control":
            return compose(self._backbone, _shadowless(prepared), no_shadow, no_shadow, fidelity)
        if method.kind == "sdedit":
            shadow, _ = prepared.shadows[0]
            latents = sdedit_latents(self._backbone, prepared.view, shadow, self._options)
            # ZeroComp darkens the photograph where the shading was hidden: here, everywhere.
            fidelity = "release"
        else:
            latents = self._spotlight(method, direction)
        predicted = develop(self._backbone, prepared.view, latents, self._options)
        return compose(self._backbone, prepared, predicted, no_shadow, fidelity)

    def evaluations(self, method: Method) -> int:
        """Denoiser evaluations of one picture, without those of the shared one."""
        steps = self._options.steps_for(self._backbone.spec)
        if method.kind == "sdedit":
            return steps + steps_again(steps)
        return steps * method.branches if method.kind == "spotlight" else 0

    def _prepared(self, method: Method, direction: Direction) -> Prepared:
        negative = direction.opposite if method.negative == "opposite" else None
        if method.kind == "spotlight" and method.negative == "opposite" and negative is None:
            raise DataError(
                f"{self._test.folder}: expected shadow_negative_{direction.name}.png for method "
                f"{method.name}, found none; add it or evaluate --methods negative-none"
            )
        guide = GuidingShadow(direction.shadow, negative)
        guide.check(self._test.scene.size)
        options = self._options
        return prepare_window(self._backbone.spec, self._test.scene, [guide], options.window)

    def _no_shadow(self, prepared: Prepared) -> FloatArray:
        if prepared.window not in self._plain:
            spec, view, options = self._backbone.spec, prepared.view, self._options
            latent = spec.latent
            shape = (1, latent.channels, *(side // latent.downscale for side in view.size))
            noise = gaussian(options.seed, "initial", shape)
            trajectory = passes.plain_pass(self._backbone.networks, spec, view, noise, options)
            self._plain[prepared.window] = develop(self._backbone, view, last(trajectory), options)
        return self._plain[prepared.window]

    def _spotlight(self, method: Method, direction: Direction) -> FloatArray:
        inputs = self._inputs(method, direction)
        if method.branches == 1:
            inputs = _one_branch(inputs)
        options = replace(self._options, gamma=method.gamma, beta=method.beta)
        spec, networks = self._backbone.spec, self._backbone.networks
        return last(passes.guided_pass(networks, spec, inputs, options))

    def _inputs(self, method: Method, direction: Direction) -> LoopInputs:
        wanted = (direction.name, method.negative)
        if self._guided is None or self._guided[0] != wanted:
            prepared = self._prepared(method, direction)
            networks, spec = self._backbone.networks, self._backbone.spec
            shadows = prepared.shadows[0]
            made = loop_inputs(networks, spec, prepared.view, shadows, self._options)
            self._guided = (wanted, made)
        return self._guided[1]


def _one_branch(inputs: LoopInputs) -> LoopInputs:
    """The positive branch alone: no guidance."""
    return replace(
        inputs,
        conditioning=inputs.conditioning[:1],
        composite_latents=inputs.composite_latents[:1],
        shadow_mask=inputs.shadow_mask[:1],
    )


def _shadowless(prepared: Prepared) -> Prepared:
    """The same window without a guiding shadow, so that nothing darkens the photograph."""
    guide = GuidingShadow(np.zeros_like(prepared.guides[0].positive))
    none = np.zeros_like(prepared.view.object_mask)
    return replace(prepared, guides=(guide,), shadows=((none, none),))


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
