"""Rays from the background to points on a light, in a fixed order that covers it evenly.

A spherical light is seen from any point as a disc. Its samples lie on a Fibonacci spiral over that
disc; along with them go offsets within the pixel on a golden-ratio lattice of two dimensions, so
that one set of rays averages over the light and over the pixel. Every pixel takes the same set:
the shadow has no noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.shadows.placement import PlacedLight
from spotlight_runtime.shadows.receiver import Patch

__all__ = ["PHASES", "Cone", "Sample", "cone_of", "probes", "spiral"]


_GOLDEN_ANGLE: Final = math.pi * (3.0 - math.sqrt(5.0))
_PLASTIC: Final = 1.32471795724474602596
"""The golden ratio of two dimensions: x³ = x + 1."""

PHASES: Final = 4
"""Of the probes: one for each pixel of a square of two by two."""
_INNER: Final = (0.25, 0.5, 0.55, 0.75)
"""Radii of the probes inside the light's disc, by phase."""

_INFINITY: Final = float("inf")


class Sample(NamedTuple):
    """Where a ray starts in its pixel, and where on the light's disc it ends."""

    dx: float
    dy: float
    a: float
    b: float


def probes(hard: bool, phase: int = 0) -> Iterator[Sample]:
    """Rays that tell what is neither lit nor dark: from the rim of the pixel to the light.

    Four for a light without extent. Else eight, five to the light's rim and three inside, where
    something small may stand in front of it; neighbouring pixels take different phases, so that
    together they leave no gap.

    Parameters
    ----------
    hard : bool
    phase : int
        From 0 to `PHASES` − 1.
    """
    if hard:
        for k in range(4):
            angle = 0.5 * math.pi * (k + 0.5)
            yield Sample(0.5 * math.cos(angle), 0.5 * math.sin(angle), 0.0, 0.0)
        return
    turn = phase / PHASES
    spots = [(1.0, (k + turn) / 5) for k in range(5)]
    spots += [(_INNER[phase], (k + turn) / 3) for k in range(3)]
    for k, (radius, share) in enumerate(spots):
        pixel, light = math.pi * (0.25 + 1.25 * k), 2.0 * math.pi * share
        dx, dy = 0.5 * math.cos(pixel), 0.5 * math.sin(pixel)
        yield Sample(dx, dy, radius * math.cos(light), radius * math.sin(light))


def spiral(count: int) -> Iterator[Sample]:
    """Rays that cover pixel and light evenly."""
    for k in range(count):
        radius, angle = math.sqrt((k + 0.5) / count), k * _GOLDEN_ANGLE
        dx, dy = (k / _PLASTIC) % 1.0 - 0.5, (k / _PLASTIC**2) % 1.0 - 0.5
        yield Sample(dx, dy, radius * math.cos(angle), radius * math.sin(angle))


@dataclass(frozen=True, slots=True, eq=False)
class Cone:
    """The light as some pixels see it.

    Attributes
    ----------
    patch : Patch
        The P pixels.
    centre : ndarray of float32, shape (3,)
        The light's position, or the direction towards it.
    directional : bool
    right, up : ndarray of float32, shape (P, 3), or None
        Radii of the disc; None for a light without extent.
    width : ndarray of float32, shape (P,), or None
        Squared tangent of the disc's angular radius.
    """

    patch: Patch
    centre: FloatArray
    directional: bool
    right: FloatArray | None
    up: FloatArray | None
    width: FloatArray | None

    @property
    def reach(self) -> float:
        """How far along a ray the light is, in lengths of its direction."""
        return _INFINITY if self.directional else 1.0

    def rays(self, sample: Sample) -> tuple[FloatArray, FloatArray]:
        """Origins and directions, float32, shape (P, 3) each; a direction ends on the disc."""
        origins = self.patch.points(sample.dx, sample.dy)
        if self.directional:
            directions = np.empty_like(origins)
            directions[:] = self.centre
        else:
            directions = self.centre - origins
        if self.right is not None and self.up is not None:
            directions += np.float32(sample.a) * self.right
            directions += np.float32(sample.b) * self.up
        return origins, directions

    def irradiance(self, sample: Sample, directions: FloatArray) -> FloatArray:
        """What a sample's part of the light would bring, shape (P,), in any unit.

        The cosine at the receiver, and the solid angle of the sample's share of the disc.
        """
        facing = np.einsum("pc,pc->p", self.patch.normals, directions)
        np.maximum(facing, 0.0, out=facing)
        if self.width is not None:
            squared = np.float32(sample.a**2 + sample.b**2)
            facing /= np.square(1.0 + squared * self.width)
        return facing

    def take(self, rows: npt.NDArray[Any]) -> Cone:
        """The cone of some of the pixels, by index or mask."""
        return Cone(
            self.patch.take(rows),
            self.centre,
            self.directional,
            None if self.right is None else self.right[rows],
            None if self.up is None else self.up[rows],
            None if self.width is None else self.width[rows],
        )


def cone_of(patch: Patch, light: PlacedLight) -> Cone:
    """How the pixels of a patch see a light.

    Parameters
    ----------
    patch : Patch
    light : PlacedLight

    Returns
    -------
    Cone
    """
    centre = light.centre.astype(np.float32)
    if light.radius == 0.0:
        return Cone(patch, centre, light.directional, None, None, None)
    if light.directional:
        axis: FloatArray = np.broadcast_to(centre, patch.normals.shape)
        squared = np.ones(len(axis), dtype=np.float32)
        radius: FloatArray = np.full(len(axis), light.radius, dtype=np.float32)
    else:
        axis = centre - patch.points()
        squared = np.einsum("pc,pc->p", axis, axis)
        # The disc that fills the sphere's outline. A receiver inside the light sees all of it.
        clear = np.maximum(squared - np.float32(light.radius**2), np.float32(1e-6) * squared)
        radius = np.float32(light.radius) * np.sqrt(squared / clear)
    # Duff et al. 2017, "Building an Orthonormal Basis, Revisited": no direction is special.
    x, y, z = (axis / np.sqrt(squared)[:, None]).T
    sign = np.where(z >= 0.0, np.float32(1.0), np.float32(-1.0))
    scale = -1.0 / (sign + z)
    cross = x * y * scale
    right = np.stack([1.0 + sign * x * x * scale, sign * cross, -sign * x], axis=1)
    up = np.stack([cross, sign + y * y * scale, -y], axis=1)
    right, up = right * radius[:, None], up * radius[:, None]
    return Cone(patch, centre, light.directional, right, up, np.square(radius) / squared)
