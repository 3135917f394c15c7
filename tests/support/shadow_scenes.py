"""Scenes whose shadows are known: a ball on a floor, and what the floor's points see of a light."""

from __future__ import annotations

import numpy as np

from spotlight_runtime import Intrinsics, Scene
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.mesh import ObjectMesh

HEIGHT, PITCH, AWAY, RADIUS = 1.5, 25.0, 2.6, 0.4
"""Of the camera above the floor, degrees it looks down, the ball's distance and radius (metres)."""


def floor(pitch: float = PITCH, height: float = HEIGHT) -> Ground:
    angle = np.deg2rad(pitch)
    return Ground((0.0, float(np.cos(angle)), float(np.sin(angle))), -height)


def floor_depth(camera: Camera, ground: Ground, farthest: float = 20.0) -> np.ndarray:
    rising = camera.rays().astype(np.float64) @ ground.normal
    depth = np.where(rising < -1e-3, ground.offset / np.minimum(rising, -1e-3), farthest)
    return np.minimum(depth, farthest).astype(np.float32)


def sphere_mesh(centre, radius: float, rings: int = 90) -> ObjectMesh:
    around, down = np.arange(rings) * 2 * np.pi / rings, np.linspace(0, np.pi, rings)
    u, v = np.meshgrid(around, down)
    points = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(rings), indexing="ij")
    a, b = i * rings + j, i * rings + (j + 1) % rings
    faces = np.concatenate(
        [
            np.stack([a, b, a + rings], -1).reshape(-1, 3),
            np.stack([b, b + rings, a + rings], -1).reshape(-1, 3),
        ]
    )
    vertices = points.reshape(-1, 3) * radius + np.asarray(centre)
    return ObjectMesh(vertices.astype(np.float32), faces.astype(np.int32))


def box_mesh(low, high, axes) -> ObjectMesh:
    """A box with corners given along the rows of ``axes``."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    vertices = (np.asarray(low) + corners * (np.asarray(high) - low)) @ axes
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return ObjectMesh(vertices.astype(np.float32), np.array(faces, np.int32))


def ball_centre(ground: Ground, away: float = AWAY, radius: float = RADIUS) -> np.ndarray:
    """Camera space; it rests on the floor, straight ahead."""
    return np.array([0.0, away, ground.offset + radius]) @ ground.world_axes()


def ball_scene(side: int = 128, width: int | None = None, **changes) -> Scene:
    """A ball on an endless floor."""
    camera, ground = Camera(width or side, side, 50.0), floor()
    centre = ball_centre(ground)
    rays = camera.rays().astype(np.float64)
    along, squared = rays @ centre, np.einsum("hwc,hwc->hw", rays, rays)
    inside = along**2 - squared * (centre @ centre - RADIUS**2)
    mask = (inside > 0).astype(np.float32)
    nearest = (along - np.sqrt(np.maximum(inside, 0))) / squared
    grey = np.full((*mask.shape, 3), 0.5, np.float32)
    scene = {
        "background": grey,
        "background_maps": Intrinsics(
            grey,
            normal=np.broadcast_to(np.float32(ground.normal), grey.shape).copy(),
            depth=floor_depth(camera, ground),
        ),
        "object_maps": Intrinsics(
            grey * mask[..., None], depth=(mask * nearest).astype(np.float32)
        ),
        "object_mask": mask,
        "field_of_view": 50.0,
        "object_mesh": sphere_mesh(centre, RADIUS),
        "ground": ground,
    }
    return Scene(**(scene | changes))


def floor_points(scene: Scene) -> np.ndarray:
    """Camera space, float64, shape (H, W, 3)."""
    return scene.camera.unproject(scene.background_maps.depth).astype(np.float64)


def light_direction(ground: Ground, azimuth: float, elevation: float) -> np.ndarray:
    a, e = np.deg2rad([azimuth, elevation])
    world = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    return world @ ground.world_axes()


def ball_hides(points, towards, centre, radius: float = RADIUS) -> np.ndarray:
    """Whether rays from points meet the ball; `towards` broadcasts against them."""
    unit = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    along = np.einsum("hwc,hwc->hw", np.broadcast_to(unit, points.shape), centre - points)
    miss = np.linalg.norm(centre - points, axis=-1) ** 2 - along**2
    return (along > 0) & (miss < radius**2)


def cap_overlap(first, second, apart) -> np.ndarray:
    """Solid angle that two spherical caps share, by their angular radii and their distance."""
    first, second, apart = np.broadcast_arrays(first, second, apart)
    smaller = np.minimum(first, second)

    def corner(near, far, across):
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = (np.cos(far) - np.cos(across) * np.cos(near)) / (np.sin(across) * np.sin(near))
        return np.arccos(np.clip(cosine, -1, 1))

    lens = 2 * (
        np.pi
        - corner(first, apart, second)
        - np.cos(first) * corner(first, second, apart)
        - np.cos(second) * corner(second, first, apart)
    )
    whole = 2 * np.pi * (1 - np.cos(smaller))
    return np.where(
        apart >= first + second, 0.0, np.where(apart <= abs(first - second), whole, lens)
    )
