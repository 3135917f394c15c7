"""Where a light stands in camera space, and whether it can stand there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import LightError
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.geometry.mesh import ObjectMesh

__all__ = ["ObjectBox", "PlacedLight", "box_of", "place_light"]


@dataclass(frozen=True, slots=True, eq=False)
class ObjectBox:
    """The object's bounding box along the floor's axes (or the camera's, where no floor is known).

    Attributes
    ----------
    axes : ndarray of float64, shape (3, 3)
        Rows right, away from the camera and up, in camera space.
    centre, half : ndarray of float64, shape (3,)
        Middle and half sides, along the axes.
    """

    axes: FloatArray
    centre: FloatArray
    half: FloatArray

    @property
    def middle(self) -> FloatArray:
        """The middle of the box, camera space."""
        return self.centre @ self.axes

    @property
    def base(self) -> FloatArray:
        """The middle of its underside, camera space."""
        return (self.centre - [0.0, 0.0, self.half[2]]) @ self.axes

    @property
    def size(self) -> float:
        """Its longest side."""
        return 2.0 * float(self.half.max())


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLight:
    """A light in camera space.

    Attributes
    ----------
    centre : ndarray of float64, shape (3,)
        Position, or the unit direction towards a light infinitely far away.
    directional : bool
    radius : float
        In the unit of the depth, or the tangent of the angular radius.
    """

    centre: FloatArray
    directional: bool
    radius: float


_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The camera's axes: right, away, up."""


def box_of(mesh: ObjectMesh, ground: Ground | None) -> ObjectBox:
    """The bounding box of the mesh along the floor's axes."""
    axes = _LEVEL if ground is None else ground.world_axes()
    along = np.einsum("vc,kc->vk", mesh.vertices.astype(np.float64), axes)
    low, high = along.min(axis=0), along.max(axis=0)
    return ObjectBox(axes, (low + high) / 2, (high - low) / 2)


def place_light(
    light: Light, box: ObjectBox, mesh: ObjectMesh, ground: Ground | None
) -> PlacedLight:
    """Find a light's place in camera space.

    Raises
    ------
    LightError
        If the light stands below the floor or in the object.
    """
    axes = box.axes if light.frame == "world" else _LEVEL
    if light.position is not None:
        placed = PlacedLight(_position(light, box), False, light.radius * box.size)
    else:
        assert light.azimuth is not None
        assert light.elevation is not None
        a, e = math.radians(light.azimuth), math.radians(light.elevation)
        towards = np.array([math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)])
        towards = towards @ axes
        if light.distance is None:
            placed = PlacedLight(towards, True, math.tan(math.radians(light.radius)))
        else:
            centre = box.middle + light.distance * box.size * towards
            placed = PlacedLight(centre, False, light.radius * box.size)
    _check_above(placed, ground)
    if not placed.directional:
        _check_outside(placed, box, mesh)
    return placed


def _position(light: Light, box: ObjectBox) -> FloatArray:
    position = np.asarray(light.position, dtype=np.float64)
    if light.frame == "world":
        return box.base + position @ box.axes
    if light.turned:
        offset = box.axes @ (position - box.base)
        return box.base + (offset * [-1.0, -1.0, 1.0]) @ box.axes
    return position


def _check_above(light: PlacedLight, ground: Ground | None) -> None:
    if ground is None:
        return
    height = float(light.centre @ ground.normal) - (0.0 if light.directional else ground.offset)
    if height <= 0.0:
        below = f"it is {-height:.3g} below"
        what = "it shines from below the horizon" if light.directional else below
        raise LightError(
            f"light: expected a place above the floor, but {what}; raise its elevation"
        )


def _check_outside(light: PlacedLight, box: ObjectBox, mesh: ObjectMesh) -> None:
    beyond = np.abs(box.axes @ light.centre - box.centre) - box.half
    if float(np.linalg.norm(np.maximum(beyond, 0.0))) > light.radius:
        return
    corners = mesh.vertices[mesh.faces].astype(np.float64) - light.centre
    if _winding(corners) > 0.5 or _distance(corners) < light.radius:
        raise LightError(
            "light: expected a place outside the object, but it reaches into it; move it away "
            "(distance) or make it smaller (radius)"
        )


def _winding(corners: npt.NDArray[np.float64]) -> float:
    """How often triangles, shape (M, 3, 3), wind round the origin, whichever way they face."""
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("mc,mc->m", a, np.cross(b, c))
    dots = (np.einsum("mc,mc->m", u, v) for u, v in ((a, b), (b, c), (c, a)))
    ab, bc, ca = dots
    solid = 2.0 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb)
    return abs(float(solid.sum())) / (4.0 * math.pi)


def _distance(corners: npt.NDArray[np.float64]) -> float:
    """Least distance of triangles, shape (M, 3, 3), from the origin."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    inside = length > 0.0
    edges = []
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        scale = np.maximum(np.einsum("mc,mc->m", along, along), np.finfo(np.float64).tiny)
        t = np.clip(-np.einsum("mc,mc->m", start, along) / scale, 0.0, 1.0)
        edges.append(np.linalg.norm(start + t[:, None] * along, axis=1))
        side = np.einsum("mc,mc->m", np.cross(along, -start), normal)
        inside &= side >= 0.0
    height = np.abs(np.einsum("mc,mc->m", a, normal)) / np.where(length > 0.0, length, 1.0)
    nearest = np.minimum(np.min(edges, axis=0), np.where(inside, height, np.inf))
    return float(nearest.min())
