"""The pinhole camera on Dr.Jit arrays."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .description import Camera, camera_axes


def ray_offset(point: Any, camera: Camera) -> Any:
    """Return the vector from the camera to a point."""
    return point - opaque(mi.Point3f, camera.position)


def camera_ray(camera: Camera, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Return rays through frame coordinates in [0, 1], x right and y down.

    Returns
    -------
    ray : mitsuba.Ray3f
        In the world.
    forward : mitsuba.Vector3f
        The optical axis.
    to_camera : callable
        Maps world vectors to camera space: x right, y up, z towards the camera.
    """
    right, up, forward = (opaque(mi.Vector3f, axis) for axis in camera_axes(camera))
    half = opaque(mi.Float, np.tan(np.deg2rad(camera.fov) / 2))
    direction = forward + right * ((2 * x - 1) * half) + up * ((1 - 2 * y) * half)
    ray = mi.Ray3f(opaque(mi.Point3f, camera.position), dr.normalize(direction))

    def to_camera(vector: Any) -> Any:
        return mi.Vector3f(dr.dot(vector, right), dr.dot(vector, up), -dr.dot(vector, forward))

    return ray, forward, to_camera


def opaque(kind: Any, value: Any) -> Any:
    """Return a value that compiled kernels read from memory, so that other values reuse them."""
    result = kind(*(float(v) for v in value)) if np.ndim(value) else kind(value)
    dr.make_opaque(result)
    return result
