"""A relight in a blink: shadow and composite without diffusion.

The object's albedo under a simple light (a share from everywhere, the rest by the cosine), over the
photograph darkened by the guiding shadow. It shows where the shadow falls and how the object
stands, not how the renderer will light it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.imaging.colour import luma
from spotlight_runtime.relighting.canvas import Canvas
from spotlight_runtime.relighting.casting import megapixel
from spotlight_runtime.relighting.guides import Guide, GuidingShadow, guiding_shadows
from spotlight_runtime.relighting.mixing import Mix
from spotlight_runtime.relighting.putback import put_back
from spotlight_runtime.relighting.window import Window
from spotlight_runtime.scenes.scene import Scene
from spotlight_runtime.shadows.shadow import floor_of

__all__ = ["Preview", "PreviewLayer", "preview", "preview_each"]


OPACITY: Final = 0.7
"""Share of the light a full shadow takes away; rooms and skies fill in the rest."""
FROM_EVERYWHERE: Final = 0.45
"""Of the photograph's own brightness; a surface that faces the light gets this and `FROM_LIGHT`."""
FROM_LIGHT: Final = 0.75
UNKNOWN: Final = (0.0, 0.8, 0.6)
"""Where light comes from if only its shadow is given: above and before the object, as lamps do."""
DARKEST_ALBEDO: Final = 0.05
ENOUGH_PIXELS: Final = 1 << 16
"""To tell how bright a photograph is."""
_LEVEL: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """A sketch of a relight.

    Attributes
    ----------
    image : ndarray of float32, shape (H, W, 3)
        sRGB-encoded, in [0, 1].
    guides : tuple of GuidingShadow
        The shadows it shows, one a light.
    """

    image: FloatArray
    guides: tuple[GuidingShadow, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PreviewLayer:
    """The sketch under one light; a `Layer`.

    Attributes
    ----------
    canvas : Canvas
    shadow : ndarray of float32, shape (H, W)
    towards : ndarray of float32, shape (3,)
        Unit vector towards the light, camera space.
    brightness : ndarray of float32, shape (3,)
        Light a white surface sends back in this photograph.
    """

    canvas: Canvas
    shadow: FloatArray
    towards: FloatArray
    brightness: FloatArray

    def rows(self, top: int, bottom: int) -> tuple[FloatArray, BoolArray]:
        """See `Layer`."""
        strip = np.s_[top:bottom]
        mask, normal = self.canvas.mask[strip], self.canvas.normal[strip]
        shadow = self.shadow[strip]
        left = (np.float32(1.0) - np.float32(OPACITY) * shadow) * (np.float32(1.0) - mask)
        light = np.clip(self.canvas.background[strip], 0.0, 1.0) * left[..., None]
        if mask.any():
            facing = np.full_like(mask, 0.5)
            if normal.shape[2]:
                cosine = normal @ self.towards
                facing = np.divide(cosine, mask, out=np.zeros_like(mask), where=mask > 0.0)
            lit = np.float32(FROM_EVERYWHERE) + np.float32(FROM_LIGHT) * np.maximum(facing, 0.0)
            light += self.canvas.albedo[strip] * (lit[..., None] * self.brightness)
        return light, (mask == 0.0) & (shadow == 0.0)


def preview(scene: Scene, light: Guide | Sequence[Guide]) -> Preview:
    """Sketch a relight.

    Parameters
    ----------
    scene : Scene
    light : Light, GuidingShadow, ndarray of float32 of shape (H, W), or a sequence of them
        As `Relighter.relight` takes it; several lights make one picture.

    Returns
    -------
    Preview

    Raises
    ------
    InvalidInputError
        If a light or shadow is out of its domain.
    """
    guides, layers = _layers(scene, light)
    image = put_back(Canvas.of(scene), Window.whole(scene.size), layers, Mix.of(guides))
    return Preview(image, guides)


def preview_each(scene: Scene, lights: Sequence[Guide]) -> Iterator[Preview]:
    """Sketch each light alone; see `preview`."""
    canvas, window = Canvas.of(scene), Window.whole(scene.size)
    for guide, layer in zip(*_layers(scene, lights)):
        yield Preview(put_back(canvas, window, [layer], Mix.of([guide])), (guide,))


def _layers(
    scene: Scene, light: Guide | Sequence[Guide]
) -> tuple[tuple[GuidingShadow, ...], list[PreviewLayer]]:
    lights = tuple(light) if isinstance(light, Sequence) else (light,)
    ready = any(isinstance(each, GuidingShadow) for each in lights)
    guides = guiding_shadows(scene, lights, None if ready else "none")
    brightness = _brightness(scene)
    towards = [
        _towards(scene, each) if isinstance(each, Light) else np.array(UNKNOWN, np.float32)
        for each in lights
    ]
    layers = [
        PreviewLayer(Canvas.of(scene), guide.positive, direction, brightness)
        for guide, direction in zip(guides, towards)
    ]
    return guides, layers


def _brightness(scene: Scene) -> FloatArray:
    """Median of light over albedo, where the photograph is not burnt out."""
    step = max(1, math.isqrt(scene.object_mask.size // ENOUGH_PIXELS))
    albedo = luma(scene.background_maps.albedo[::step, ::step])
    light = luma(np.clip(scene.background[::step, ::step], 0.0, 1.0))
    usable = (albedo > DARKEST_ALBEDO) & (light < 1.0)
    level = float(np.median(light[usable] / albedo[usable])) if usable.any() else 1.0
    return np.full(3, level, dtype=np.float32)


def _towards(scene: Scene, light: Light) -> FloatArray:
    """Unit vector from the object towards the light, camera space, near enough for a sketch."""
    ground = scene.ground
    if ground is None and light.frame == "world":
        ground = floor_of(megapixel(scene))
    axes = _LEVEL if ground is None or light.frame == "camera" else ground.world_axes()
    if light.position is None:
        azimuth, elevation = math.radians(light.azimuth or 0.0), math.radians(light.elevation or 0)
        across = math.cos(elevation)
        offset = np.array(
            [across * math.cos(azimuth), across * math.sin(azimuth), math.sin(elevation)]
        )
        towards = offset @ axes
    elif light.frame == "world":
        towards = np.array(light.position) @ axes
    else:
        towards = np.array(light.position) - _middle(scene)
    return (towards / max(float(np.linalg.norm(towards)), 1e-6)).astype(np.float32)


def _middle(scene: Scene) -> FloatArray:
    """Where the object is, camera space."""
    if scene.object_mesh is not None:
        return np.asarray(scene.object_mesh.vertices.mean(axis=0))
    depth, inside = scene.object_maps.depth, scene.object_mask == 1.0
    if depth is None or not inside.any():
        return np.array([0.0, 0.0, -1.0])
    return np.asarray(scene.camera.unproject(depth)[inside].mean(axis=0))
