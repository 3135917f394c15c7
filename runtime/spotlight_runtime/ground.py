"""The floor: a plane in camera space, found from depth and normals or given by two clicks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.camera import Camera
from spotlight_runtime.errors import GroundError, InvalidInputError

__all__ = ["Ground", "fit_ground", "ground_from_clicks"]


EYE_LEVEL: Final = 1.6
"""Metres; how high a camera is taken to be held where nothing else says."""


@dataclass(frozen=True, slots=True)
class Ground:
    """The plane ``normal · p = offset`` in camera space.

    Attributes
    ----------
    normal : (x, y, z)
        Unit length, pointing up.
    offset : float
        In the unit of the depth; minus the camera's height above the plane.
    """

    normal: tuple[float, float, float]
    offset: float

    def __post_init__(self) -> None:
        length = math.sqrt(sum(value * value for value in self.normal))
        if not abs(length - 1.0) < 1e-3:  # also refuses NaN
            raise InvalidInputError(
                f"ground normal: expected a vector of length 1, got {self.normal}"
            )
        if not math.isfinite(self.offset):
            raise InvalidInputError(f"ground offset: expected a finite number, got {self.offset}")

    def world_axes(self) -> FloatArray:
        """The floor's axes in camera coordinates.

        Returns
        -------
        ndarray of float64, shape (3, 3)
            Rows x (the camera's right, made horizontal), y (away from the camera) and z (up):
            ``world_axes() @ p`` turns a camera-space direction into the world's.
        """
        z = np.asarray(self.normal, dtype=np.float64)
        z /= np.linalg.norm(z)
        x = np.array([1.0, 0.0, 0.0]) - z[0] * z
        if np.linalg.norm(x) < 1e-3:  # a camera rolled by 90 degrees: take what its up leaves
            x = np.cross([0.0, 0.0, -1.0], z)
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z])


def fit_ground(
    camera: Camera,
    depth: FloatArray,
    normal: FloatArray | None = None,
    mask: BoolArray | None = None,
) -> Ground:
    """Find the floor in depth and normals."""
    raise NotImplementedError


def ground_from_clicks(
    camera: Camera,
    horizon_y: float,
    contact: tuple[float, float],
    *,
    camera_height: float | None = None,
    contact_depth: float | None = None,
) -> Ground:
    """Place the floor by two clicks: the horizon, and a point where something stands on it.

    Parameters
    ----------
    camera : Camera
    horizon_y : float
        Row of the horizon in pixels, which may lie outside the picture; the camera does not roll.
    contact : (x, y)
        A pixel of the floor, below the horizon.
    camera_height : float, optional
        Metres above the floor; 1.6, eye level, if neither this nor ``contact_depth`` is given.
    contact_depth : float, optional
        Instead, the depth of the contact point, in the depth map's unit.

    Raises
    ------
    GroundError
        If the contact point does not lie below the horizon.
    InvalidInputError
        If both or impossible lengths are given.
    """
    if camera_height is not None and contact_depth is not None:
        raise InvalidInputError("ground: expected camera_height or contact_depth, got both")
    x, y = contact
    if not y > horizon_y:
        raise GroundError(
            f"contact point: expected a row below the horizon ({horizon_y:g}), got {y:g}; "
            "click where something meets the floor"
        )
    slope = (0.5 * camera.height - horizon_y) / camera.focal
    up = np.array([0.0, 1.0, slope]) / math.hypot(1.0, slope)
    length = EYE_LEVEL if camera_height is None else camera_height
    if contact_depth is not None:
        ray = [(x - 0.5 * camera.width), (0.5 * camera.height - y), -camera.focal]
        length = -contact_depth * float(up @ np.array(ray)) / camera.focal
    if not (math.isfinite(length) and length > 0.0):
        raise InvalidInputError(f"ground: expected a positive length in metres, got {length}")
    return Ground((0.0, float(up[1]), float(up[2])), -length)
