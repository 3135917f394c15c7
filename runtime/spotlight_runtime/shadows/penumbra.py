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

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.shadows.aim import PHASES, Cone, cone_of, probes, spiral
from spotlight_runtime.shadows.obstacle import Obstacle
from spotlight_runtime.shadows.occluder import Occluder
from spotlight_runtime.shadows.placement import PlacedLight
from spotlight_runtime.shadows.receiver import Receiver

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

_PARTLY: Final = 1
_WHOLLY: Final = 2
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
    cone, hard = cone_of(receiver.patch(pixels), light), light.radius == 0.0
    phases = None if hard else _phases(pixels, shape[1])
    level = np.zeros(shape, dtype=np.uint8)
    level.flat[pixels] = _probe(cone, occluder, phases)
    # Lit beside dark, without a partial pixel between, is an outline too.
    differs = (cv2.dilate(level, _SQUARE) != cv2.erode(level, _SQUARE)).flat[pixels]
    level = level.flat[pixels]
    mixed = differs | (level == _PARTLY)
    touched = np.flatnonzero(mixed | (level == _WHOLLY))
    hidden = np.zeros(len(pixels), dtype=np.uint8)
    hidden[touched] = _hidden(cone.take(touched), obstacle, hard)
    reached = hidden < _WHOLLY
    shadow.flat[pixels[(level == _WHOLLY) & reached]] = 1.0
    partly = hidden == _PARTLY

    def sample(rows: _Pixels) -> FloatArray:
        values = np.empty(len(rows), dtype=np.float32)
        for group, way in ((~partly[rows], None), (partly[rows], obstacle)):
            values[group] = _sample(cone.take(rows[group]), occluder, way, samples)
        return values

    _fill(shadow, receiver.inverse_depth, pixels, np.flatnonzero(mixed & reached), sample)
    return shadow


def _phases(pixels: _Pixels, width: int) -> _Pixels:
    """Which probes a pixel takes: each of a square of two by two its own."""
    rows, columns = np.divmod(pixels, width)
    return 2 * (rows % 2) + columns % 2


def _probe(cone: Cone, occluder: Occluder, phases: _Pixels | None) -> npt.NDArray[np.uint8]:
    """How much of the light is hidden from each pixel, shape (P,): not, partly or wholly."""
    if phases is None:
        return _level([occluder.blocks(*cone.rays(p), cone.reach) for p in probes(True)])
    result = np.zeros(len(phases), dtype=np.uint8)
    for phase in range(PHASES):
        group = np.flatnonzero(phases == phase)
        part, chosen = cone.take(group), probes(False, phase)
        result[group] = _level([occluder.blocks(*part.rays(p), cone.reach) for p in chosen])
    return result


def _hidden(cone: Cone, obstacle: Obstacle, hard: bool) -> npt.NDArray[np.uint8]:
    """The same for the background in the way, or turned away from the light."""
    blocked = []
    # Fewer than of the object: this is the shadow of a coarse surface, and decides on less.
    for probe in list(probes(hard))[:: 1 if hard else 2]:
        origins, directions = cone.rays(probe)
        away = cone.irradiance(probe, directions) <= 0.0
        blocked.append(away | obstacle.hides(cone, origins, directions))
    return _level(blocked)


def _level(blocked: list[BoolArray]) -> npt.NDArray[np.uint8]:
    """Not, partly or wholly blocked, from one array a probe."""
    some, every = np.any(blocked, axis=0), np.all(blocked, axis=0)
    return some.astype(np.uint8) + every.astype(np.uint8)


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
    """Write the partial shadow of ``pixels[mixed]`` into ``shadow``; ``sample`` takes its rows.

    From a coarse lattice to finer ones, each for what the one before was too coarse for.
    """
    step = 1
    while step < _COARSEST and len(mixed) > _SAMPLED_PIXELS * step**2:
        step *= 2
    # What is not sampled yet is unknown, so that no cell takes it for light.
    shadow.flat[pixels[mixed]] = np.nan
    while step > 1:
        rows, columns = np.divmod(pixels[mixed], shadow.shape[1])
        on_lattice = (rows % step == 0) & (columns % step == 0)
        shadow.flat[pixels[mixed[on_lattice]]] = sample(mixed[on_lattice])
        between = np.flatnonzero(~on_lattice)
        values, smooth = _interpolate(shadow, inverse_depth, rows[between], columns[between], step)
        shadow.flat[pixels[mixed[between[smooth]]]] = values[smooth]
        mixed = mixed[between[~smooth]]
        step //= 2
    shadow.flat[pixels[mixed]] = sample(mixed)


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
