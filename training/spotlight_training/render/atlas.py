"""One texture for a whole scene: tiles of albedo, roughness and metalness packed at fixed places.

All scenes then have the same structure (two meshes, one texture), so the renderer's compiled
kernels are reused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .mesh import Array

WIDTH, HEIGHT = 2048, 1536
CHANNELS = 5
"""Albedo red, green, blue, roughness, metalness."""
INSET = 1.5
"""Texels kept free along a tile's border, so that bilinear lookups never reach its neighbour."""

_FLOOR = (0, 0, 1024)
_WALLS = ((1024, 0, 512), (1024, 512, 512), (1536, 0, 512))
_FREE = [(x, y) for y in (1024, 1280) for x in range(0, WIDTH, 256)] + [
    (x, y) for y in (512, 768) for x in (1536, 1792)
]


@dataclass(frozen=True)
class Tile:
    """A square of the atlas: left, top and side in texels."""

    left: int
    top: int
    side: int

    def place(self, uv: Array) -> Array:
        """Map tile coordinates in [0, 1], shape (N, 2), to atlas coordinates in [0, 1]."""
        origin = np.array([self.left, self.top]) + INSET
        return (origin + uv * (self.side - 2 * INSET)) / [WIDTH, HEIGHT]


class Atlas:
    """Hands out tiles and holds their texels.

    `image` is float32, shape (HEIGHT, WIDTH, CHANNELS).
    """

    def __init__(self) -> None:
        self.image = np.full((HEIGHT, WIDTH, CHANNELS), 0.5, dtype=np.float32)
        self._walls = list(_WALLS)
        self._large = list(_FREE)
        self._small: list[tuple[int, int]] = []

    def floor(self) -> Tile:
        """Return the floor's tile."""
        return Tile(*_FLOOR)

    def wall(self) -> Tile:
        """Return the next wall's tile; there are three."""
        return Tile(*self._walls.pop(0))

    def large(self) -> Tile:
        """Return a tile of 256 texels, for what is looked at closely."""
        if not self._large:
            raise ValueError(
                f"texture atlas: a scene may use {len(_FREE)} tiles of 256 texels, and all are "
                "taken. "
                "Use fewer clutter items or fewer materials in the external object."
            )
        return Tile(*self._large.pop(0), 256)

    def small(self) -> Tile:
        """Return a tile of 128 texels, for clutter."""
        if not self._small:
            tile = self.large()
            self._small = [(tile.left + x, tile.top + y) for y in (0, 128) for x in (0, 128)]
        return Tile(*self._small.pop(0), 128)

    def paint(
        self, tile: Tile, albedo: Array, roughness: Array | float, metallic: Array | float
    ) -> None:
        """Write a tile's texels.

        Albedo (S, S, 3) linear, roughness and metalness (S, S) or one number, in [0, 1].
        """
        area = self.image[tile.top : tile.top + tile.side, tile.left : tile.left + tile.side]
        area[..., :3] = albedo
        area[..., 3] = np.clip(roughness, 0.08, 1.0)
        area[..., 4] = metallic
