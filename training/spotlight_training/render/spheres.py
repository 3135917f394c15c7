"""Spherical lights as data: sampled by the solid angle they fill, and met by rays analytically.

They are not part of the traced geometry. So no light hides another, none shows in the picture, and
switching between them rebuilds nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .description import Light


@dataclass
class LightTable:
    """The lights' centres, radii and radiances in device buffers, one row a light.

    Kept as buffers, not constants, so that a compiled kernel serves every scene with the same
    number of lights.
    """

    centre: Any
    radius: Any
    radiance: Any
    count: int

    @staticmethod
    def load(lights: Sequence[Light]) -> LightTable:
        """Upload lights, each as bright as `Light` says."""
        centre = np.array([light.position for light in lights], dtype=np.float32)
        radius = np.array([light.radius for light in lights], dtype=np.float32)
        colour = np.array([light.colour for light in lights], dtype=np.float32)
        distance = np.array([light.distance for light in lights], dtype=np.float32)
        radiance = colour * np.square(distance / radius)[:, None]
        return LightTable(
            mi.Float(centre.ravel()),
            mi.Float(radius),
            mi.Float(radiance.astype(np.float32).ravel()),
            len(lights),
        )

    def row(self, index: Any) -> SphereLight:
        """Return one light; `index` is a number or a UInt32 array."""
        i = mi.UInt32(index)
        return SphereLight(
            dr.gather(mi.Point3f, self.centre, i),
            dr.gather(mi.Float, self.radius, i),
            dr.gather(mi.Color3f, self.radiance, i),
        )


@dataclass
class SphereLight:
    """One light a lane: centre (m), radius (m), radiance."""

    centre: Any
    radius: Any
    radiance: Any

    def sample(self, origin: Any, point: Any) -> tuple[Any, Any, Any]:
        """Draw a direction towards the visible cap.

        Return it, the distance to the sphere and the density per sr.
        """
        axis = self.centre - origin
        distance2 = dr.squared_norm(axis)
        width = self._cap(distance2)
        drop = point.x * width
        cosine = 1 - drop
        sine = dr.sqrt(dr.maximum(drop * (1 + cosine), 0))
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * point.y)
        frame = mi.Frame3f(axis * dr.rsqrt(distance2))
        direction = frame.to_world(mi.Vector3f(sine * cos_phi, sine * sin_phi, cosine))
        inside = dr.maximum(dr.square(self.radius) - distance2 * dr.square(sine), 0)
        return direction, dr.sqrt(distance2) * cosine - dr.sqrt(inside), dr.inv_two_pi / width

    def meet(self, origin: Any, direction: Any) -> tuple[Any, Any, Any]:
        """Return whether a ray meets the sphere, how far off, and `sample`'s density."""
        axis = self.centre - origin
        distance2 = dr.squared_norm(axis)
        along = dr.dot(axis, direction)
        miss2 = distance2 - dr.square(along)
        hit = (along > 0) & (miss2 < dr.square(self.radius)) & (distance2 > dr.square(self.radius))
        reach = along - dr.sqrt(dr.maximum(dr.square(self.radius) - miss2, 0))
        return hit, reach, dr.inv_two_pi / self._cap(distance2)

    def _cap(self, distance2: Any) -> Any:
        """Return 1 - cos of the half angle, in a form that keeps its digits for small lights."""
        sin2 = dr.minimum(dr.square(self.radius) / distance2, 0.999)
        return dr.maximum(sin2 / (1 + dr.sqrt(1 - sin2)), 1e-9)
