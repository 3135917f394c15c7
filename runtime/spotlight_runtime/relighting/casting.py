"""Guiding shadows of photographs of any size: cast where that is cheap, carried to where not.

A shadow under an extended light has no detail that a megapixel does not show, so larger scenes
cast on a smaller picture of themselves and the shadow is magnified, free of the hole that the
object leaves in it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import ShadowWarning
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.imaging.upsampling import fit_guided, magnify_rows
from spotlight_runtime.relighting.window import Window, look
from spotlight_runtime.scenes.scene import Scene
from spotlight_runtime.shadows.shadow import ShadowCaster

__all__ = ["Cast", "caster_of", "megapixel", "say_of"]


MOST_PIXELS: Final = 1 << 20
STRIP: Final = 64
LEAST_SEEN: Final = 0.05
"""Share of a pixel beside the object below which its shadow is rather taken from around."""

Cast = Callable[[Light, bool], FloatArray]
"""``cast(light, asked for) -> shadow``: (H, W) float32 in [0, 1]; what nobody asked for (the
opposite light's) may fall where it is not seen without a warning."""


def caster_of(scene: Scene) -> Cast:
    """Make a scene ready to cast the shadows of many lights.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Cast

    Raises
    ------
    GroundError, MissingExtraError
        See `ShadowCaster`.
    """
    small = megapixel(scene)
    caster = ShadowCaster(small)

    def cast(light: Light, asked_for: bool) -> FloatArray:
        result = caster.cast(light)
        if result.notice is not None and asked_for:
            say_of(light, result.notice)
        if small is scene:
            return result.shadow
        return _magnified(result.shadow, small.object_mask, scene.object_mask)

    return cast


def say_of(light: Light, notice: str) -> None:
    """Warn of something about the shadows of a light."""
    where = "" if light.azimuth is None else f"light at azimuth {light.azimuth:g}°: "
    warnings.warn(where + notice, ShadowWarning, stacklevel=3)


def megapixel(scene: Scene) -> Scene:
    """The whole scene, geometry included, shrunk to a megapixel where it has more."""
    height, width = scene.size
    factor = math.sqrt(MOST_PIXELS / (height * width))
    if factor >= 1.0:
        return scene
    size = max(1, round(height * factor)), max(1, round(width * factor))
    small = look(scene, Window(0, 0, height, width, size, scene.size))
    return replace(
        small,
        field_of_view=scene.field_of_view,
        object_mesh=scene.object_mesh,
        ground=scene.ground,
    )


def _magnified(shadow: FloatArray, small_mask: FloatArray, mask: FloatArray) -> FloatArray:
    """Bring a shadow, cleared under the object, to the mask's size, filling the hole on the way."""
    seen = np.clip(np.float32(1.0) - small_mask, 0.0, 1.0)
    whole = np.divide(shadow, seen, out=np.zeros_like(shadow), where=seen > LEAST_SEEN)
    weight = np.where(seen > LEAST_SEEN, seen, np.float32(0.0))
    nothing = shadow[..., None][..., :0]
    fit = fit_guided(whole, weight, nothing, ridge=(0.0,), usual=(0.0,))
    filled = fit.coefficients[..., 0]
    filled = np.where(seen == 1.0, shadow, np.clip(filled, 0.0, 1.0))
    height, width = mask.shape
    large = np.zeros((height, width), dtype=np.float32)
    for top in range(0, height, STRIP):
        bottom = min(top + STRIP, height)
        rows = magnify_rows(filled, top, bottom, (height, width))
        if rows.any():  # rows of zeros that are not written take no memory
            large[top:bottom] = rows * np.clip(np.float32(1.0) - mask[top:bottom], 0.0, 1.0)
    return large
