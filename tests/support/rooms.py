"""A room made with numpy: a floor, a back wall, and what stands on the floor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from spotlight_runtime.composing.backdrop import Backdrop
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.scenes.scene import Intrinsics

HEIGHT, PITCH, WALL = 1.5, 15.0, 6.0
"""Of the camera above the floor, how many degrees it looks down, and how far the wall is."""


def room_ground(height: float = HEIGHT, pitch: float = PITCH) -> Ground:
    p = math.radians(pitch)
    return Ground((0.0, math.cos(p), math.sin(p)), -height)


def room(
    width: int = 160,
    height: int = 120,
    *,
    block: tuple[float, float, float] | None = None,
    field_of_view: float = 60.0,
) -> Backdrop:
    """A checkered floor and a grey wall, exactly known.

    Parameters
    ----------
    block : (left, right, away), optional
        A screen as high as the camera, between two world x, that far away.
    """
    camera = Camera(width, height, field_of_view)
    ground = room_ground()
    right, away, up = ground.world_axes()
    rays = camera.rays().astype(np.float64)
    x, y, z = rays @ right, rays @ away, rays @ up
    with np.errstate(divide="ignore"):
        floor = np.where(z < 0.0, -HEIGHT / z, np.inf)
    wall = np.where(y > 0.0, WALL / np.maximum(y, 1e-9), np.inf)
    depth = np.minimum(floor, wall)
    on_floor = floor < wall
    normal = np.where(on_floor[..., None], up, -away)
    checker = (np.floor(x * depth) + np.floor(y * depth)) % 2
    albedo = np.where(on_floor, 0.3 + 0.3 * checker, 0.6)[..., None] * [1.0, 0.9, 0.8]
    if block is not None:
        screen = block[2] / np.maximum(y, 1e-9)
        reach = (x * screen >= block[0]) & (x * screen <= block[1]) & (z * screen <= 0.0)
        hit = reach & (y > 0.0) & (screen < depth)
        depth = np.where(hit, screen, depth)
        normal = np.where(hit[..., None], -away, normal)
        albedo = np.where(hit[..., None], [0.2, 0.3, 0.7], albedo)
    light = 0.4 + 0.5 * normal @ (0.8 * up + 0.6 * right)
    radiance = np.clip(albedo * light[..., None], 0.0, 1.0).astype(np.float32)
    maps = Intrinsics(
        albedo=albedo.astype(np.float32),
        normal=normal.astype(np.float32),
        depth=depth.astype(np.float32),
    )
    return Backdrop(Photograph(radiance, field_of_view, "room"), maps, ground)


def oracle_network(backdrop: Backdrop, unit: float = 1.0) -> Any:
    """A network that knows the room: its maps, shrunk to whatever size it is asked at."""
    import cv2

    def network(image: np.ndarray) -> dict[str, np.ndarray]:
        size = image.shape[:1:-1]
        maps = backdrop.maps
        planes = [maps.albedo, maps.normal, maps.depth[..., None] * np.float32(unit)]
        small = [cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in planes]
        stacked = np.concatenate([p.reshape(*size[::-1], -1) for p in small], axis=2)
        return {"maps": np.ascontiguousarray(stacked.transpose(2, 0, 1)[None])}

    return network
