"""Where the object stands: a point of the photograph on the floor, a turn and a size."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.product import Product, weld
from spotlight_runtime.errors import GroundError, InvalidInputError, PlacementError
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground

__all__ = ["Placement", "floor_point", "pose_product", "scaling"]


NEAREST: Final = 0.02
"""Metres (or units of depth); the object has to stay this far in front of the camera."""
FARTHEST_SHARE: Final = 200.0
"""Camera heights away; beyond, a pixel of the floor is metres long and a click means nothing."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Where and how large the object stands.

    Attributes
    ----------
    at : (x, y)
        Point of the photograph where the middle of the object's underside touches the floor:
        fractions of width and height, from the upper left corner.
    yaw : float
        Degrees counter-clockwise seen from above; at 0 the model's front faces the camera.
    size : float, optional
        Length in metres of the object's longest side.
    height : float, optional
        Instead, its height in metres. With neither, the model's own size counts as metres.
    """

    at: tuple[float, float]
    yaw: float = 0.0
    size: float | None = None
    height: float | None = None

    def __post_init__(self) -> None:
        if not all(0.0 <= value <= 1.0 for value in self.at):
            raise PlacementError(
                f"at: expected a point of the photograph, fractions between 0 and 1, got "
                f"{self.at[0]:g},{self.at[1]:g}; pick a point inside the picture"
            )
        if not math.isfinite(self.yaw):
            raise InvalidInputError(f"yaw: expected degrees, got {self.yaw}")
        if self.size is not None and self.height is not None:
            raise InvalidInputError("placement: expected a size or a height, got both")
        for name, value in (("size", self.size), ("height", self.height)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InvalidInputError(f"{name}: expected metres, more than 0, got {value}")


def floor_point(camera: Camera, ground: Ground, at: tuple[float, float]) -> FloatArray:
    """The point of the floor that a point of the photograph shows.

    Returns
    -------
    ndarray of float64, shape (3,)
        Camera space.

    Raises
    ------
    GroundError
        If the photograph does not show floor there.
    """
    x, y = at[0] * camera.width, at[1] * camera.height
    ray = np.array([x - 0.5 * camera.width, 0.5 * camera.height - y, -camera.focal]) / camera.focal
    falling = float(np.asarray(ground.normal) @ ray)
    # The camera stands above the floor, so the offset is negative and rays have to fall.
    depth = ground.offset / falling if falling != 0.0 else math.inf
    if not 0.0 < depth < FARTHEST_SHARE * abs(ground.offset):
        raise GroundError(
            f"at: the point {at[0]:g},{at[1]:g} lies on or above the horizon, where there is no "
            "floor to stand on; pick a lower point, or state the horizon (--horizon)"
        )
    return ray * depth


def scaling(placement: Placement, sides: npt.ArrayLike) -> float:
    """Factor from a model's units to metres.

    Parameters
    ----------
    placement : Placement
    sides : array of shape (3,)
        Of the model's bounding box, y up.
    """
    lengths = np.asarray(sides, dtype=np.float64)
    if placement.size is not None:
        return placement.size / float(lengths.max())
    if placement.height is not None:
        if lengths[1] <= 0.0:
            raise InvalidInputError("height: the object is flat; give its size instead")
        return placement.height / float(lengths[1])
    return 1.0


def pose_product(product: Product, placement: Placement, camera: Camera, ground: Ground) -> Product:
    """Stand a product on the floor.

    Parameters
    ----------
    product : Product
        Model space.
    placement : Placement
    camera : Camera
    ground : Ground
        In metres.

    Returns
    -------
    Product
        With vertices and normals in camera space.

    Raises
    ------
    GroundError
        If there is no floor at the point.
    PlacementError
        If the object reaches behind the camera.
    """
    low, high = product.bounds
    scale = scaling(placement, high - low)
    base = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2], dtype=np.float64)
    right, away, up = ground.world_axes()
    turn = math.radians(placement.yaw)
    # The model's axes in camera space: its x, its y (up) and its z (front, towards the camera).
    across = math.cos(turn) * right + math.sin(turn) * away
    front = math.sin(turn) * right - math.cos(turn) * away
    rotation = np.stack([across, up, front])
    foot = floor_point(camera, ground, placement.at)
    vertices = (product.vertices.astype(np.float64) - base) * scale @ rotation + foot
    vertices = _exactly(vertices, product)
    nearest = float(-vertices[np.unique(product.faces), 2].max())
    if nearest < NEAREST:
        raise PlacementError(
            f"{product.name}: the object reaches to {-nearest:.2g} m behind the camera; "
            "place it further up in the picture or make it smaller (--size)"
        )
    normals = (product.normals.astype(np.float64) @ rotation).astype(np.float32)
    return replace(product, vertices=vertices, normals=normals)


def _exactly(vertices: FloatArray, product: Product) -> FloatArray:
    """Give vertices that share a place in the model one place here: rounding may part them."""
    place = weld(product.vertices)
    first = np.zeros(place.max() + 1, dtype=np.intp)
    first[place] = np.arange(len(place))
    return vertices[first[place]].astype(np.float32)
