"""Light following: whether the object's shading shows the light it was asked to have.

The output for light k is compared with the truths of all eight azimuths, on the object alone and
by shading alone: pixels are made linear and divided by the object's albedo, and their luminance is
what is left. Two shadings are as far apart as they differ after the best scaling of one onto the
other, since the light's strength is free: ``1 − ⟨a,b⟩² / (⟨a,a⟩⟨b,b⟩)``. The nearest truth says
which light the picture shows. With eight azimuths chance is 12.5 % for the right one, and 37.5 %
for one within ±45°.

A second distance leaves a constant free as well (one minus the correlation): it asks for the shape
of the shading whatever its contrast, so a picture with too much ambient light still follows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from spotlight_bench.dataset import AZIMUTHS
from spotlight_bench.metrics import HALF_COVERED
from spotlight_runtime import Scene
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import srgb_to_linear

__all__ = ["distances", "is_near", "is_right", "shading"]

DARKEST_ALBEDO: Final = 0.02
"""Where a channel reflects less, its quotient is noise."""
WHOLLY_COVERED: Final = 0.99
LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])
"""Of linear Rec. 709 primaries."""


def shading(picture: FloatArray, scene: Scene) -> FloatArray:
    """Luminance of the object's shading.

    Parameters
    ----------
    picture : ndarray of float32, shape (H, W, 3)
        sRGB-encoded, in [0, 1].
    scene : Scene
        Its object's albedo and mask are used.

    Returns
    -------
    ndarray of float64, shape (pixels,)
        Of the pixels that the object covers wholly: divided by a dark albedo, what shines through
        a soft edge would outweigh the rest. (Where there are none, by half or more.)
    """
    covered = scene.object_mask >= WHOLLY_COVERED
    if not covered.any():
        covered = scene.object_mask >= HALF_COVERED
    cover = scene.object_mask[covered][:, None].astype(np.float64)
    albedo = scene.object_maps.albedo[covered] / cover
    light = srgb_to_linear(picture[covered]).astype(np.float64)
    return np.asarray((light / np.maximum(albedo, DARKEST_ALBEDO)) @ LUMINANCE)


def distances(
    shown: FloatArray, truths: Sequence[FloatArray], *, offset_free: bool = False
) -> list[float]:
    """Distance in [0, 2] of a shading from each of the truths'.

    Parameters
    ----------
    shown : ndarray of float64, shape (pixels,)
        See `shading`.
    truths : sequence of ndarray of float64, shape (pixels,)
    offset_free : bool
        Leave a constant free besides the scale: one minus the correlation. Without it, one minus
        the square of the cosine.
    """
    return [_distance(shown, truth, offset_free) for truth in truths]


def is_right(found: Sequence[float], wanted: int) -> bool:
    """Whether the nearest truth is the wanted light's."""
    return int(np.argmin(found)) == wanted


def is_near(found: Sequence[float], wanted: int) -> bool:
    """Whether the nearest truth is the wanted light's or one beside it (±45°)."""
    apart = abs(int(np.argmin(found)) - wanted)
    return min(apart, len(AZIMUTHS) - apart) <= 1


def _distance(a: FloatArray, b: FloatArray, offset_free: bool) -> float:
    if a.size == 0:
        return 1.0
    if offset_free:
        a, b = a - a.mean(), b - b.mean()
    norms = float(a @ a) * float(b @ b)
    if norms <= 0.0:  # a black or, with the constant free, a flat shading resembles none
        return 1.0
    cosine = float(a @ b) / math.sqrt(norms)
    return 1.0 - cosine if offset_free else 1.0 - cosine**2
