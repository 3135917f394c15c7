"""Object kinds turned on a lathe: vessels, bottles and chessmen, drawn as `simple_kinds` does."""

from __future__ import annotations

import numpy as np

from .mesh import Array, Shape
from .solids import cylinder, lathe

Rng = np.random.Generator


def vase(rng: Rng) -> Shape:
    """Return a hollow vase with a random belly and neck."""
    return lathe(
        _hollow(_spline(rng, (0.18, 0.32), (0.25, 0.5), (0.1, 0.3), (0.14, 0.34)), 0.03),
        segments=48,
    )


def bottle(rng: Rng) -> Shape:
    """Return a bottle with a cap in a second material."""
    radius, shoulder, neck = rng.uniform(0.14, 0.24), rng.uniform(0.5, 0.7), rng.uniform(0.05, 0.08)
    body = _smooth_profile(
        [(radius, 0.04), (radius, shoulder), (neck, shoulder + 0.2), (neck, 0.93)], 30
    )
    shape = lathe(np.concatenate([[[0, 0], [radius * 0.94, 0]], body, [[0, 0.93]]]), segments=40)
    shape += cylinder(neck * 1.15, 0.09, (0, 0, 0.92), slot=1)
    if rng.random() < 0.5:
        shape += cylinder(radius * 1.005, 0.25, (0, 0, 0.15), slot=2, segments=40)
    return shape


def bowl(rng: Rng) -> Shape:
    """Return an open bowl with a foot."""
    width, foot, height = 0.5, rng.uniform(0.14, 0.25), rng.uniform(0.25, 0.5)
    power = rng.uniform(0.35, 0.8)
    t = np.linspace(0, 1, 16)
    wall = np.stack([foot + (width - foot) * t**power, height * t], 1)
    return lathe(_hollow(wall, 0.03), segments=48)


def goblet(rng: Rng) -> Shape:
    """Return a stemmed glass shape."""
    cup, stem, foot = rng.uniform(0.2, 0.34), rng.uniform(0.02, 0.04), rng.uniform(0.16, 0.26)
    split = rng.uniform(0.4, 0.6)
    outer = _smooth_profile(
        [(foot, 0.02), (stem, 0.08), (stem, split), (cup, split + 0.2), (cup * 0.85, 1.0)], 40
    )
    return lathe(_hollow(outer, 0.015), segments=40)


def pawn(rng: Rng) -> Shape:
    """Return a chess-piece-like turned figure."""
    base, waist, head = rng.uniform(0.25, 0.34), rng.uniform(0.07, 0.12), rng.uniform(0.14, 0.2)
    collar = rng.uniform(0.6, 0.7)
    stem = _smooth_profile([(base, 0.08), (base * 0.8, 0.16), (waist, 0.35), (waist, collar)], 24)
    arc = np.linspace(-1.2, np.pi / 2, 18)
    top = np.stack([head * np.cos(arc), collar + 0.08 + head * (1 + np.sin(arc)) - 0.05], 1)
    top[-1, 0] = 0.0
    collar_rim = [[waist * 2.2, collar], [waist * 2.2, collar + 0.05]]
    return lathe(np.concatenate([[[0, 0], [base, 0]], stem, collar_rim, top]), segments=40)


def _spline(rng: Rng, *ranges: tuple[float, float]) -> Array:
    """Return a smooth profile of unit height through random radii at even heights."""
    heights = np.linspace(0, 1, len(ranges))
    return _smooth_profile([(rng.uniform(*r), h) for r, h in zip(ranges, heights, strict=True)], 36)


def _smooth_profile(points: list[tuple[float, float]], count: int) -> Array:
    """Resample control points by chord length; eased, so that radii never overshoot."""
    control = np.asarray(points, dtype=np.float64)
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(control, axis=0), axis=1))])
    t = np.linspace(0, chord[-1], count)
    index = np.clip(np.searchsorted(chord, t, side="right") - 1, 0, len(chord) - 2)
    local = ((t - chord[index]) / np.diff(chord)[index])[:, None]
    ease = local * local * (3 - 2 * local)
    straight = control[index] + (control[index + 1] - control[index]) * local
    eased = control[index, :1] + (control[index + 1, :1] - control[index, :1]) * ease
    return np.concatenate([eased, straight[:, 1:]], axis=1)


def _hollow(wall: Array, thickness: float) -> Array:
    """Turn an outer wall profile into a closed vessel profile.

    Floor, outside, rim, inside, inner floor.
    """
    inside = wall[::-1].copy()
    inside[:, 0] = np.maximum(inside[:, 0] - thickness, 0.004)
    inside = inside[inside[:, 1] > thickness * 1.5]
    floor = wall[0, 1]
    return np.concatenate([[[0.0, floor]], wall, inside, [[0.0, inside[-1, 1]]]])
