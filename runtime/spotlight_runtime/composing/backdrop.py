"""A photograph with its intrinsic maps and its floor, in metres: what an object is put into."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.composing.settling import settle
from spotlight_runtime.composing.verticals import up_from_verticals
from spotlight_runtime.errors import (
    GroundError,
    InvalidInputError,
    MissingMapError,
    NonFiniteError,
    ShapeError,
)
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground, fit_ground, ground_from_clicks
from spotlight_runtime.imaging.colour import decode_to_linear
from spotlight_runtime.imaging.images import read_image
from spotlight_runtime.scenes.scene import MAP_NAMES, Intrinsics

__all__ = ["CAMERA_HEIGHT", "NEEDED", "Backdrop", "build_backdrop", "combine_maps", "read_map"]


CAMERA_HEIGHT: Final = 1.5
"""Metres above the floor a photograph is taken from where nobody says."""
FIT_SIDE: Final = 512
"""Pixels of the longer side from which the floor is fitted; a plane needs no more."""
SAME_SHAPE: Final = 0.02
"""Aspect ratios that differ by less than this share are the same picture at another size."""
NEAR_CONTACT: Final = 0.01
"""Share of the picture's diagonal around the contact point whose depth is the contact's."""
NEEDED: Final = ("albedo", "normal", "depth")
"""Maps without which there is no scene; roughness and metalness have usual values."""

FloorSource = Literal["horizon", "upright edges", "depth"]


@dataclass(frozen=True, slots=True, eq=False)
class Backdrop:
    """What an object is put into.

    Attributes
    ----------
    photograph : Photograph
    maps : Intrinsics
        At the photograph's size; depth in metres.
    ground : Ground
        In metres.
    source : {"horizon", "upright edges", "depth"}
        What the floor was found by.
    """

    photograph: Photograph
    maps: Intrinsics
    ground: Ground
    source: FloorSource = "depth"


def read_map(path: Path, name: str, size: tuple[int, int], scale: float = 1.0) -> FloatArray:
    """Read an intrinsic map that a user brings, at the photograph's size.

    Parameters
    ----------
    path : Path
        Albedo: linear in EXR, sRGB-encoded otherwise. Normals: in [−1, 1] in EXR, 0.5 + 0.5·n
        otherwise. Depth, roughness, metallic: as stored.
    name : {"albedo", "normal", "depth", "roughness", "metallic"}
    size : tuple of int
        Height and width it is brought to.
    scale : float
        Multiplies depth: metres per stored unit.

    Raises
    ------
    ShapeError
        If it has another shape than the photograph, or too few channels.
    NonFiniteError
        If it holds NaN or infinity.
    """
    pixels = read_image(path)
    channels = 3 if name in ("albedo", "normal") else 1
    planes = pixels[..., None] if pixels.ndim == 2 else pixels
    if planes.shape[2] < channels:
        raise ShapeError(
            f"{path}: expected {channels} channels in the {name} map, got {planes.shape[2]}; "
            "export it in colour"
        )
    height, width = planes.shape[:2]
    if abs(width * size[0] - height * size[1]) > SAME_SHAPE * width * size[0]:
        raise ShapeError(
            f"{path}: expected the photograph's shape, {size[1]}×{size[0]} or smaller alike, "
            f"got {width}×{height}; export the {name} map of the same picture"
        )
    value = np.ascontiguousarray(planes[..., :channels])
    if not np.isfinite(value).all():
        raise NonFiniteError(
            f"{path}: the {name} map holds NaN or infinity; replace them and export it again"
        )
    stored_exactly = path.suffix.lower() == ".exr"
    if name == "albedo":
        value = np.clip(value if stored_exactly else decode_to_linear(value, "srgb"), 0.0, 1.0)
    elif name == "normal":
        value = value if stored_exactly else np.float32(2.0) * value - np.float32(1.0)
    elif name == "depth":
        value = value * np.float32(scale)
    if (height, width) != size:
        value = cv2.resize(value, size[::-1], interpolation=cv2.INTER_LINEAR)
    if name == "normal":
        length = np.linalg.norm(value, axis=2, keepdims=True)
        value = value / np.maximum(length, np.float32(1e-6))
    return np.ascontiguousarray(value.reshape(*size, 3) if channels == 3 else value.reshape(size))


def combine_maps(given: Mapping[str, FloatArray], estimated: Intrinsics | None) -> Intrinsics:
    """Maps a user gives, and for the rest the estimator's.

    Raises
    ------
    MissingMapError
        If albedo, normals or depth are neither given nor estimated.
    """
    maps: dict[str, Any] = {}
    for name in MAP_NAMES:
        value = given.get(name)
        maps[name] = getattr(estimated, name) if value is None and estimated else value
    missing = [name for name in NEEDED if maps[name] is None]
    if missing:
        raise MissingMapError(
            f"background: expected {', '.join(NEEDED)}, missing {', '.join(missing)}; give "
            f"{' '.join('--' + name for name in missing)}, or a model that estimates them "
            "(--estimator)"
        )
    return Intrinsics(**maps)


def build_backdrop(
    photograph: Photograph,
    maps: Intrinsics,
    *,
    estimated: bool = False,
    contact: tuple[float, float] | None = None,
    horizon: float | None = None,
    camera_height: float | None = None,
) -> Backdrop:
    """Find the floor and bring depth to metres.

    Parameters
    ----------
    photograph : Photograph
    maps : Intrinsics
        Depth in any unit if it is estimated or ``camera_height`` is given, in metres otherwise.
    estimated : bool
        Whether depth and normals are a network's guess. Then the photograph's upright edges say
        better where the floor is, and depth is settled on it.
    contact : (x, y), optional
        A point where something stands on the floor, in fractions of the picture; needed with
        ``horizon``.
    horizon : float, optional
        Row of the horizon as a fraction of the picture's height (it may lie outside); the camera
        does not roll. If not given, the floor is found.
    camera_height : float, optional
        Metres above the floor, from which the scale of the depth follows; `CAMERA_HEIGHT` if depth
        is estimated and nobody says.

    Raises
    ------
    GroundError
        If no floor is found.
    InvalidInputError
        If the camera's height is not positive.
    """
    if camera_height is not None and not (math.isfinite(camera_height) and camera_height > 0.0):
        raise InvalidInputError(f"camera height: expected metres, more than 0, got {camera_height}")
    if maps.depth is None:
        raise MissingMapError("background: expected depth, got none; give --depth")
    if horizon is not None and contact is None:
        raise InvalidInputError("horizon: expected a contact point beside it, got none")
    camera = photograph.camera
    if estimated:
        height = CAMERA_HEIGHT if camera_height is None else camera_height
        ground, sign = _seen_floor(photograph, maps, contact, horizon, height)
        return Backdrop(photograph, settle(maps, camera, ground), ground, sign)
    if horizon is not None and contact is not None:
        ground, scale = _clicked(camera, maps.depth, contact, horizon, camera_height)
        source: FloorSource = "horizon"
    else:
        ground, source = _fitted(camera, maps), "depth"
        scale = 1.0 if camera_height is None else camera_height / -ground.offset
        ground = Ground(ground.normal, ground.offset * scale)
    if scale != 1.0:
        maps = replace(maps, depth=maps.depth * np.float32(scale))
    return Backdrop(photograph, maps, ground, source)


def _seen_floor(
    photograph: Photograph,
    maps: Intrinsics,
    contact: tuple[float, float] | None,
    horizon: float | None,
    height: float,
) -> tuple[Ground, FloorSource]:
    """The floor of a photograph whose depth is a guess, by the surest sign there is."""
    camera = photograph.camera
    if horizon is not None and contact is not None:
        row, point = horizon * camera.height, _pixels(camera, contact)
        return ground_from_clicks(camera, row, point, camera_height=height), "horizon"
    up = up_from_verticals(photograph)
    if up is not None:
        return Ground(up, -height), "upright edges"
    return Ground(_fitted(camera, maps).normal, -height), "depth"


def _clicked(
    camera: Camera,
    depth: FloatArray,
    contact: tuple[float, float],
    horizon: float,
    height: float | None,
) -> tuple[Ground, float]:
    """The floor by horizon and contact, and what brings the depth to its unit."""
    row, (x, y) = horizon * camera.height, _pixels(camera, contact)
    near = _depth_around(depth, contact)
    if height is None:
        return ground_from_clicks(camera, row, (x, y), contact_depth=near), 1.0
    ground = ground_from_clicks(camera, row, (x, y), camera_height=height)
    ray = np.array([x - 0.5 * camera.width, 0.5 * camera.height - y, -camera.focal])
    far = ground.offset * camera.focal / float(np.asarray(ground.normal) @ ray)
    return ground, far / near


def _pixels(camera: Camera, at: tuple[float, float]) -> tuple[float, float]:
    return at[0] * camera.width, at[1] * camera.height


def _fitted(camera: Camera, maps: Intrinsics) -> Ground:
    """Fit the floor to every k-th pixel."""
    assert maps.depth is not None, "asked only with depth"
    step = max(1, math.ceil(max(camera.width, camera.height) / FIT_SIDE))
    grid = np.s_[step // 2 :: step, step // 2 :: step]
    depth = np.ascontiguousarray(maps.depth[grid])
    normal = None if maps.normal is None else np.ascontiguousarray(maps.normal[grid])
    small = Camera(depth.shape[1], depth.shape[0], camera.field_of_view)
    try:
        return fit_ground(small, depth, normal)
    except GroundError as error:
        raise GroundError(
            "background: no floor found in the photograph's depth and normals; say where it is "
            "with the row of the horizon as a fraction of the height (--horizon 0.4) and a point "
            f"of contact (--at) ({error})"
        ) from error


def _depth_around(depth: FloatArray, at: tuple[float, float]) -> float:
    """Median depth around a point, which one wrong pixel cannot change."""
    height, width = depth.shape
    reach = max(1, round(NEAR_CONTACT * math.hypot(height, width)))
    x = min(int(at[0] * width), width - 1)
    y = min(int(at[1] * height), height - 1)
    patch = depth[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
    near = float(np.median(patch))
    if near <= 0.0:
        raise GroundError(
            f"depth: expected metres at the contact point {at[0]:g},{at[1]:g}, got {near:g}; "
            "pick another point or correct the depth map"
        )
    return near
