"""Procedural surface patterns.

Numpy arrays of albedo and relative roughness, evaluated on metric coordinates.

A pattern is a function of (canvas, three linear colours) to a blend; colours are linear RGB in [0,
1]. Nothing here repeats inside a tile, so a tile can be stretched over the whole surface that it
covers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Canvas:
    """Coordinates of a tile's texels, in pattern periods, and the randomness to decorate them.

    Attributes
    ----------
    x, y : float32 array, shape (H, W)
        Position in units of the pattern's period (one plank, one tile, one stripe).
    rng : numpy.random.Generator
    """

    x: Array
    y: Array
    rng: np.random.Generator

    def noise(
        self, frequency: float = 1.0, octaves: int = 4, stretch: tuple[float, float] = (1.0, 1.0)
    ) -> Array:
        """Return fractal value noise in about [-1, 1], `frequency` lattice cells a period."""
        total, amplitude, norm = np.zeros_like(self.x), 1.0, 0.0
        for octave in range(octaves):
            scale = frequency * 2.0**octave
            lattice = self.rng.uniform(-1.0, 1.0, (64, 64)).astype(np.float32)
            shift = self.rng.uniform(0.0, 64.0, 2).astype(np.float32)
            # Folded into the wrapped lattice by hand: remap's own wrapping mishandles the last
            # cell.
            u = (self.x * np.float32(scale * stretch[0]) + shift[0]) % np.float32(64.0)
            v = (self.y * np.float32(scale * stretch[1]) + shift[1]) % np.float32(64.0)
            padded = np.pad(lattice, ((0, 1), (0, 1)), mode="wrap")
            total += amplitude * cv2.remap(padded, u, v, cv2.INTER_LINEAR)
            norm += amplitude
            amplitude *= 0.55
        return total * np.float32(1.6 / norm)


Pattern = Callable[[Canvas], tuple[Array, Array, Array]]
"""Returns (t, shade, gloss): the mix over the three colours in [0, 2], a brightness factor, and a
roughness factor."""


def _cells(column: Array, row: Array, rng: np.random.Generator) -> Array:
    """Return one uniform number in [0, 1) for each cell, shape (H, W)."""
    table = rng.random((61, 67)).astype(np.float32)
    return table[row.astype(np.int64) % 61, column.astype(np.int64) % 67]


def _gap(x: Array, y: Array, width: float) -> Array:
    """Return 1 in the joints of a unit grid and 0 inside its cells, with soft borders."""
    edge = np.minimum(np.abs(x - np.round(x)), np.abs(y - np.round(y)))
    return np.clip(1.5 - edge / width, 0.0, 1.0)


def plain(c: Canvas) -> tuple[Array, Array, Array]:
    """One colour with the faintest unevenness."""
    return np.zeros_like(c.x), 1.0 + 0.02 * c.noise(2.0, 3), np.ones_like(c.x)


def plaster(c: Canvas) -> tuple[Array, Array, Array]:
    """Painted wall: broad cloudiness and fine grain."""
    return 0.25 + 0.25 * c.noise(0.7, 4), 1.0 + 0.05 * c.noise(9.0, 3), 1.0 + 0.1 * c.noise(1.0, 2)


def planks(c: Canvas) -> tuple[Array, Array, Array]:
    """Wooden boards, staggered, with grain and their own tints."""
    row = np.floor(c.y)
    shift = _cells(np.zeros_like(row), row, c.rng) * 6.0
    board = c.x / 6.0 + shift
    tint = _cells(np.floor(board), row, c.rng)
    joint = np.maximum(
        _gap(c.y, np.full_like(c.y, 0.5), 0.03),
        np.clip(1.5 - np.abs(board - np.round(board)) / 0.004, 0, 1),
    )
    grain = c.noise(1.5, 5, (0.25, 5.0))
    t = np.clip(0.45 * tint + 0.35 * (0.5 + 0.5 * grain), 0, 1)
    return (
        t,
        (0.8 + 0.35 * tint + 0.08 * grain) * (1 - 0.7 * joint),
        1.0 + 0.25 * grain + 0.5 * joint,
    )


def wood(c: Canvas) -> tuple[Array, Array, Array]:
    """One piece of wood with rings."""
    rings = np.sin(2 * np.pi * (1.2 * c.y + 0.8 * c.noise(0.5, 3, (0.25, 1.5))) * 2.0)
    grain = c.noise(2.0, 4, (0.2, 6.0))
    return np.clip(0.5 + 0.3 * rings + 0.25 * grain, 0, 1), 1.0 + 0.08 * grain, 1.0 + 0.2 * grain


def tiles(c: Canvas) -> tuple[Array, Array, Array]:
    """Square tiles with grout."""
    gap = _gap(c.x, c.y, 0.02)
    tint = _cells(np.floor(c.x), np.floor(c.y), c.rng)
    t = np.where(gap > 0.5, 2.0, 0.3 * tint + 0.1 * c.noise(2.0, 4))
    return t, 1.0 + 0.12 * (tint - 0.5) - 0.2 * gap, 0.7 + 1.3 * gap


def checker(c: Canvas) -> tuple[Array, Array, Array]:
    """Two-colour checkerboard."""
    odd = (np.floor(c.x) + np.floor(c.y)) % 2
    return odd.astype(np.float32), 1.0 + 0.06 * c.noise(2.0, 4), 1.0 + 0.15 * c.noise(1.0, 3)


def bricks(c: Canvas) -> tuple[Array, Array, Array]:
    """Running-bond bricks with mortar."""
    row = np.floor(c.y * 2.0)
    x = c.x + 0.5 * (row % 2)
    gap = np.maximum(
        np.clip(1.5 - np.abs(x - np.round(x)) / 0.03, 0, 1),
        np.clip(1.5 - np.abs(c.y * 2 - np.round(c.y * 2)) / 0.06, 0, 1),
    )
    tint = _cells(np.floor(x), row, c.rng)
    t = np.where(gap > 0.5, 2.0, tint)
    return t, (0.85 + 0.3 * tint) * (1 + 0.15 * c.noise(6.0, 4)), 1.0 + 0.2 * gap


def carpet(c: Canvas) -> tuple[Array, Array, Array]:
    """Short pile: strong fine noise over faint clouds."""
    fine = c.noise(16.0, 3)
    return (
        np.clip(0.4 + 0.3 * c.noise(0.6, 3) + 0.25 * fine, 0, 1),
        1.0 + 0.28 * fine,
        np.full_like(c.x, 2.0),
    )


def marble(c: Canvas) -> tuple[Array, Array, Array]:
    """Veins along warped waves."""
    warp = c.noise(0.6, 5)
    vein = 1 - np.abs(np.sin(np.pi * (0.6 * c.x + 0.4 * c.y + 1.6 * warp)))
    return np.clip(1.6 * vein**6 + 0.25 * warp, 0, 1.4), np.ones_like(c.x), 0.5 + 0.1 * warp


def concrete(c: Canvas) -> tuple[Array, Array, Array]:
    """Blotched grey-like surface with pores."""
    clouds, pores = c.noise(0.5, 6), c.noise(14.0, 2)
    return (
        np.clip(0.5 + 0.5 * clouds, 0, 1),
        1.0 + 0.1 * clouds - 0.25 * np.clip(pores - 0.6, 0, 1),
        1.0 + 0.15 * clouds,
    )


def stripes(c: Canvas) -> tuple[Array, Array, Array]:
    """Two-colour stripes with a thin third colour."""
    phase = c.x % 1.0
    t = np.where(phase < 0.5, 0.0, np.where(phase < 0.58, 2.0, 1.0))
    return t, 1.0 + 0.05 * c.noise(8.0, 3), np.ones_like(c.x)


def fabric(c: Canvas) -> tuple[Array, Array, Array]:
    """Woven threads, fine enough to blur at a distance, with uneven dye."""
    weave = np.sin(2 * np.pi * 11 * c.x) * np.sin(2 * np.pi * 11 * c.y)
    dye = c.noise(1.0, 5)
    return (
        np.clip(0.3 + 0.25 * weave + 0.3 * dye, 0, 1),
        1.0 + 0.08 * weave + 0.06 * dye,
        np.full_like(c.x, 1.6),
    )


def plaid(c: Canvas) -> tuple[Array, Array, Array]:
    """Tartan: crossing bands."""
    across, along = (c.x % 1.0) < 0.35, (c.y % 1.0) < 0.35
    thin = (np.abs(c.x % 1.0 - 0.7) < 0.04) | (np.abs(c.y % 1.0 - 0.7) < 0.04)
    t = 0.5 * across + 0.5 * along
    return (
        np.where(thin, 2.0, t).astype(np.float32),
        1.0 + 0.05 * c.noise(12.0, 2),
        np.full_like(c.x, 1.5),
    )


def dots(c: Canvas) -> tuple[Array, Array, Array]:
    """Polka dots on staggered rows."""
    x = c.x + 0.5 * (np.floor(c.y) % 2)
    distance = np.hypot(x % 1.0 - 0.5, c.y % 1.0 - 0.5)
    return (distance < 0.28).astype(np.float32), 1.0 + 0.04 * c.noise(4.0, 3), np.ones_like(c.x)


def terrazzo(c: Canvas) -> tuple[Array, Array, Array]:
    """Chips of two colours in a ground colour."""
    chips = c.noise(7.0, 1)
    other = c.noise(7.0, 1)
    t = np.where(chips > 0.75, 1.0, np.where(other > 0.85, 2.0, 0.0))
    return t.astype(np.float32), 1.0 + 0.05 * c.noise(2.0, 3), np.full_like(c.x, 0.6)


def patches(c: Canvas) -> tuple[Array, Array, Array]:
    """Broad noisy patches of all three colours, as glaze, rust or camouflage have."""
    blend = c.noise(1.2, 5)
    return np.clip(1.0 + 1.4 * blend, 0, 2), 1.0 + 0.08 * c.noise(8.0, 3), 1.0 + 0.35 * blend


PATTERNS: dict[str, Pattern] = {
    pattern.__name__: pattern
    for pattern in (
        plain,
        plaster,
        planks,
        wood,
        tiles,
        checker,
        bricks,
        carpet,
        marble,
        concrete,
        stripes,
        fabric,
        plaid,
        dots,
        terrazzo,
        patches,
    )
}


def bake(
    pattern: str,
    seed: int,
    colours: Array,
    period: float,
    size: tuple[int, int],
    extent: tuple[float, float],
) -> tuple[Array, Array]:
    """Evaluate a pattern over a tile.

    Parameters
    ----------
    pattern : str
        A key of `PATTERNS`.
    seed : int
        Seeds the pattern's own decoration.
    colours : array, shape (3, 3)
        Linear RGB of the ground, the second and the third colour, in [0, 1].
    period : float
        Metres that one repeat of the pattern covers.
    size : (int, int)
        Height and width of the tile in texels.
    extent : (float, float)
        Metres that the tile covers, vertically and horizontally.

    Returns
    -------
    albedo : float32 array, shape (H, W, 3), linear, in [0.01, 0.95]
    gloss : float32 array, shape (H, W)
        Factor on the material's roughness, in [0.3, 2.5].
    """
    if pattern not in PATTERNS:
        raise KeyError(
            f"material pattern: expected one of {', '.join(sorted(PATTERNS))}; got {pattern!r}."
        )
    rows = (np.arange(size[0], dtype=np.float32) + 0.5) * np.float32(extent[0] / size[0] / period)
    columns = (np.arange(size[1], dtype=np.float32) + 0.5) * np.float32(
        extent[1] / size[1] / period
    )
    x, y = np.meshgrid(columns, rows)
    t, shade, gloss = PATTERNS[pattern](Canvas(x, y, np.random.default_rng(seed)))
    t = np.clip(t, 0.0, 2.0)[..., None]
    first, second, third = np.asarray(colours, dtype=np.float32)
    albedo = np.where(t < 1, first + (second - first) * t, second + (third - second) * (t - 1))
    albedo = albedo * np.clip(shade, 0.2, 1.6)[..., None]
    return np.clip(albedo, 0.01, 0.95).astype(np.float32), np.clip(gloss, 0.3, 2.5).astype(
        np.float32
    )
