"""From rays to a shadow: probe every pixel that may be touched, sample only where it matters.

1. A few probes a pixel, from its rim to the light's rim, tell umbra from light.
2. Where the probes or a neighbour's disagree is penumbra or outline; there the shadow is the
   share of irradiance that the object takes away, ``1 − with/without`` (method.md §2).
3. A wide penumbra changes slowly: of a large one a lattice is sampled, and what lies between is
   interpolated where shadow and surface are smooth, sampled elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.aim import Cone, cone_of, probes, spiral
from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.obstacle import Obstacle
from spotlight_runtime.occluder import Occluder
from spotlight_runtime.placement import PlacedLight
from spotlight_runtime.receiver import Receiver

__all__ = ["SAMPLES", "trace"]


SAMPLES: Final = 64
"""Rays a pixel of the penumbra: steps of 1/64 are finer than an eye tells apart in a shadow."""

_SAMPLED_PIXELS: Final = 12_000
"""Beyond so many pixels of penumbra a lattice of them is sampled."""
_COARSEST: Final = 4
_SMOOTH: Final = 0.2
"""Differences in a lattice cell, of the shadow, up to which it is interpolated."""
_FLAT: Final = 0.01
"""Relative difference of 1/depth from the lattice's up to which a pixel lies on its surface."""

_Pixels = npt.NDArray[np.int64]
_SQUARE: Final = np.ones((3, 3), np.uint8)


def trace(
    receiver: Receiver,
    pixels: _Pixels,
    light: PlacedLight,
    occluder: Occluder,
    obstacle: Obstacle,
    samples: int,
) -> FloatArray:
    """Cast an occluder's shadow on some pixels of a receiver.

    Parameters
    ----------
    receiver : Receiver
    pixels : ndarray of int64, shape (P,)
        Flat indices of the pixels that can be reached; elsewhere there is no shadow.
    light : PlacedLight
    occluder : Occluder
    obstacle : Obstacle
    samples : int
        Rays a pixel where the shadow is partial.

    Returns
    -------
    ndarray of float32, shape (H, W)
        In [0, 1].
    """
    shape = receiver.inverse_depth.shape
    shadow = np.zeros(shape, dtype=np.float32)
    if not len(pixels):
        return shadow
    cone = cone_of(receiver.patch(pixels), light)
    hits, most = _probe(cone, occluder, hard=light.radius == 0.0)
    spread = np.zeros(shape, dtype=np.uint8)
    spread.flat[pixels] = hits
    high, low = cv2.dilate(spread, _SQUARE), cv2.erode(spread, _SQUARE)
    mixed = (high != low).flat[pixels] | ((hits > 0) & (hits < most))
    touched = np.flatnonzero((hits > 0) | mixed)
    hidden = np.zeros(len(pixels), dtype=np.uint8)
    hidden[touched], most_hidden = _hidden(cone.take(touched), obstacle, light.radius == 0.0)
    dark = hidden == most_hidden
    shadow.flat[pixels[(hits == most) & ~dark]] = 1.0
    partly = (hidden > 0) & ~dark

    def sample(rows: _Pixels) -> FloatArray:
        values = np.empty(len(rows), dtype=np.float32)
        for group, way in ((~partly[rows], None), (partly[rows], obstacle)):
            values[group] = _sample(cone.take(rows[group]), occluder, way, samples)
        return values

    _fill(shadow, receiver.inverse_depth, pixels, np.flatnonzero(mixed & ~dark), sample)
    return shadow


def _probe(cone: Cone, occluder: Occluder, hard: bool) -> tuple[npt.NDArray[np.uint8], int]:
    """How many probes each pixel's light is hidden from, shape (P,), and how many there are."""
    hits = np.zeros(len(cone.patch.normals), dtype=np.uint8)
    chosen = list(probes(hard))
    for probe in chosen:
        hits += occluder.blocks(*cone.rays(probe), cone.reach)
    return hits, len(chosen)


def _hidden(cone: Cone, obstacle: Obstacle, hard: bool) -> tuple[npt.NDArray[np.uint8], int]:
    """The same for the background in the way, or turned away from the light."""
    hits = np.zeros(len(cone.patch.normals), dtype=np.uint8)
    chosen = list(probes(hard))[:: 1 if hard else 2]
    for probe in chosen:
        origins, directions = cone.rays(probe)
        away = cone.irradiance(probe, directions) <= 0.0
        hits += away | obstacle.hides(cone, origins, directions)
    return hits, len(chosen)


def _sample(cone: Cone, occluder: Occluder, obstacle: Obstacle | None, samples: int) -> FloatArray:
    """1 − with/without of every pixel of a cone, shape (P,)."""
    without = np.zeros(len(cone.patch.normals), dtype=np.float32)
    taken = np.zeros_like(without)
    for sample in spiral(samples):
        origins, directions = cone.rays(sample)
        light = cone.irradiance(sample, directions)
        if obstacle is not None:
            light[obstacle.hides(cone, origins, directions)] = 0.0
        without += light
        taken += light * occluder.blocks(origins, directions, cone.reach)
    return np.divide(taken, without, out=np.zeros_like(taken), where=without > 0.0)


def _fill(
    shadow: FloatArray,
    inverse_depth: FloatArray,
    pixels: _Pixels,
    mixed: _Pixels,
    sample: Callable[[_Pixels], FloatArray],
) -> None:
    """Write the partial shadow of ``pixels[mixed]`` into ``shadow``; ``sample`` takes its rows."""
    step = 1
    while step < _COARSEST and len(mixed) > _SAMPLED_PIXELS * step**2:
        step *= 2
    if step == 1:
        shadow.flat[pixels[mixed]] = sample(mixed)
        return
    rows, columns = np.divmod(pixels[mixed], shadow.shape[1])
    on_lattice = (rows % step == 0) & (columns % step == 0)
    # What is not sampled yet is unknown, so that no cell takes it for light.
    shadow.flat[pixels[mixed]] = np.nan
    shadow.flat[pixels[mixed[on_lattice]]] = sample(mixed[on_lattice])
    between = np.flatnonzero(~on_lattice)
    values, smooth = _interpolate(shadow, inverse_depth, rows[between], columns[between], step)
    shadow.flat[pixels[mixed[between[smooth]]]] = values[smooth]
    rest = mixed[between[~smooth]]
    shadow.flat[pixels[rest]] = sample(rest)


def _interpolate(
    shadow: FloatArray, inverse_depth: FloatArray, rows: _Pixels, columns: _Pixels, step: int
) -> tuple[FloatArray, BoolArray]:
    """Bilinear values between lattice points, and where shadow and surface are smooth enough."""
    top, left = rows // step * step, columns // step * step
    inside = (top + step < shadow.shape[0]) & (left + step < shadow.shape[1])
    down = ((rows - top) / step).astype(np.float32)
    across = ((columns - left) / step).astype(np.float32)
    value, surface = np.zeros(len(rows), np.float32), np.zeros(len(rows), np.float32)
    low, high = np.full(len(rows), np.inf, np.float32), np.full(len(rows), -np.inf, np.float32)
    for below in (0, step):
        for right in (0, step):
            corner = (np.where(inside, top + below, 0), np.where(inside, left + right, 0))
            weight = (down if below else 1.0 - down) * (across if right else 1.0 - across)
            value += weight * shadow[corner]
            surface += weight * inverse_depth[corner]
            inside &= inverse_depth[corner] > 0.0
            low, high = np.minimum(low, shadow[corner]), np.maximum(high, shadow[corner])
    here = inverse_depth[rows, columns]
    flat = np.abs(surface - here) <= _FLAT * here
    smooth = inside & flat & (high - low <= _SMOOTH)  # also refuses NaN
    return value, np.asarray(smooth)
