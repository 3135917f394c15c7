"""The floor: a plane in camera space, found from depth and normals or given by two clicks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.errors import GroundError, InvalidInputError
from spotlight_runtime.geometry.camera import Camera

__all__ = ["Ground", "fit_ground", "ground_from_clicks", "normals_of"]


EYE_LEVEL: Final = 1.6
"""Metres; how high a camera is taken to be held where nothing else says."""

_FIT_PIXELS: Final = 40_000
_SCORED_POINTS: Final = 2_000
_HYPOTHESES: Final = 400
"""With a quarter of the upward-facing pixels on the floor, all triples miss it once in 500 fits."""
_REFINEMENTS: Final = 8
_TOLERANCE: Final = 0.02
"""Of the depth: what an estimator's floor bends."""
_ALIKE: Final = math.cos(math.radians(30.0))
_LEAST_UPWARD: Final = 0.2
"""Of a normal's y: the floor under a camera that looks down by up to 78 degrees."""
_LEAST_SHARE: Final = 0.04
_TUKEY: Final = 6.9
"""Tukey's 4.685 standard deviations, in medians of the absolute residual."""


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
    """Find the floor in depth and normals: the plane most of the upward-facing pixels share.

    Planes through random triples of points (always the same ones) are scored by how many pixels
    lie on them and face their way; the best is refined by reweighted total least squares with
    Tukey's weights. Distances count relative to depth, as a depth map's errors do.

    Parameters
    ----------
    camera : Camera
    depth : ndarray of float32, shape (H, W)
        Of the background; 0 where unknown.
    normal : ndarray of float32, shape (H, W, 3), optional
        Camera space; taken from the depth where it is not given.
    mask : ndarray of bool, shape (H, W), optional
        Pixels that may show the floor; all of them by default.

    Returns
    -------
    Ground

    Raises
    ------
    GroundError
        If fewer than one pixel in 25 agree on a floor.
    """
    step = max(1, math.ceil(math.sqrt(depth.size / _FIT_PIXELS)))
    if normal is None:
        normal = normals_of(camera.unproject(depth))
    rays, facing = camera.rays()[::step, ::step], normal[::step, ::step]
    far = depth[::step, ::step]
    usable = (far > 0.0) & (facing[..., 1] > _LEAST_UPWARD)
    # A surface seen at all faces the camera; normals that do not are mistakes.
    usable &= np.einsum("hwc,hwc->hw", facing, rays) < 0.0
    if mask is not None:
        usable &= mask[::step, ::step]
    points = (rays * far[..., None])[usable].astype(np.float64)
    facing = facing[usable].astype(np.float64)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    if len(points) >= 3:
        plane = _refined(points, facing, _consensus(points, facing))
        share = float(_agreeing(points, facing, *plane).sum()) / far.size
        if share >= _LEAST_SHARE and plane[1] < 0.0:
            return Ground(tuple(float(v) for v in plane[0]), float(plane[1]))  # type: ignore[arg-type]
    raise GroundError(
        "ground: expected depth and normals that show a floor, found no plane that faces up and "
        f"fills {_LEAST_SHARE:.0%} of the picture; give the floor by the horizon and a point of "
        "contact, or turn the light in the camera's frame"
    )


def normals_of(points: FloatArray) -> FloatArray:
    """Normals of a grid of points, from differences that do not cross an edge in depth.

    Parameters
    ----------
    points : ndarray of float32, shape (H, W, 3)
        Camera space.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        Unit length, towards the camera.
    """
    across, down = _smaller_difference(points, 1), _smaller_difference(points, 0)
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    towards = np.where(np.einsum("hwc,hwc->hw", normals, points) > 0.0, -1.0, 1.0)[..., None]
    unit = normals * towards / np.maximum(length, np.finfo(np.float32).tiny)
    return np.where(length > 0.0, unit, np.array([0.0, 0.0, 1.0])).astype(np.float32)


def _smaller_difference(points: FloatArray, axis: int) -> FloatArray:
    """Forward or backward difference, whichever changes depth less."""
    if points.shape[axis] < 2:
        return np.zeros_like(points)
    steps = np.diff(points, axis=axis)
    first, last = np.take(steps, [0], axis), np.take(steps, [-1], axis)
    back, ahead = np.concatenate([first, steps], axis), np.concatenate([steps, last], axis)
    flatter = np.abs(ahead[..., 2:]) <= np.abs(back[..., 2:])
    return np.asarray(np.where(flatter, ahead, back), dtype=points.dtype)


def _consensus(points: FloatArray, facing: FloatArray) -> tuple[FloatArray, float]:
    """The plane through three random points that most points agree with."""
    rng = np.random.default_rng(0)
    few = rng.choice(len(points), min(len(points), _SCORED_POINTS), replace=False)
    corners = points[rng.integers(len(points), size=(_HYPOTHESES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals[length == 0.0] = [0.0, 1.0, 0.0]
    normals /= np.where(length == 0.0, 1.0, length)[:, None] * np.where(normals[:, 1:2] < 0, -1, 1)
    offsets = np.einsum("nc,nc->n", normals, corners[:, 0])
    distance = np.abs(points[few] @ normals.T - offsets) / np.abs(points[few, 2:])
    alike = facing[few] @ normals.T > _ALIKE
    best = int(((distance < _TOLERANCE) & alike).sum(axis=0).argmax())
    return normals[best], float(offsets[best])


def _refined(
    points: FloatArray, facing: FloatArray, plane: tuple[FloatArray, float]
) -> tuple[FloatArray, float]:
    normal, offset = plane
    depth = np.abs(points[:, 2])
    for _ in range(_REFINEMENTS):
        near = _agreeing(points, facing, normal, offset)
        if near.sum() < 3:
            break
        residual = np.abs(points[near] @ normal - offset) / depth[near]
        width = max(_TUKEY * float(np.median(residual)), 1e-6)
        weight = np.maximum(1.0 - (residual / width) ** 2, 0.0) ** 2 / depth[near] ** 2
        centre = np.average(points[near], axis=0, weights=weight)
        spread = (points[near] - centre) * np.sqrt(weight)[:, None]
        normal = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        normal = normal if normal[1] >= 0.0 else -normal
        offset = float(normal @ centre)
    return normal, offset


def _agreeing(
    points: FloatArray, facing: FloatArray, normal: FloatArray, offset: float
) -> BoolArray:
    near = np.abs(points @ normal - offset) < _TOLERANCE * np.abs(points[:, 2])
    return near & (facing @ normal > _ALIKE)


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
