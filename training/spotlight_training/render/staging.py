"""Places camera, walls and clutter: the object stays in view and in the light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import kinds
from .description import Camera, Item, Light, Wall, direction, project
from .materials import object_materials, wall_material
from .mesh import Array, bounds, rest_and_scale, rotation, transform_all

Rng = np.random.Generator

CAMERA_HEIGHTS = (0.8, 1.8)
FILL = (0.27, 0.55)
WIDEST = 0.72
CAMERA_CLEARANCE = 0.4


def place_camera(rng: Rng, extent: Array, height: float) -> Camera:
    """Draw a camera that sees the object at 27 to 55 % of the frame's height, from above.

    Parameters
    ----------
    rng : numpy.random.Generator
    extent : array, shape (3,)
        The object's bounding-box sides in metres; it stands at (0, 0, height).
    height : float
        Of the supporting surface, in metres.
    """
    best, best_miss = None, np.inf
    for _ in range(40):
        camera = _try_camera(rng, extent, height)
        z = camera.position[2]
        miss = max(CAMERA_HEIGHTS[0] - z, z - CAMERA_HEIGHTS[1], 0.0)
        if miss < best_miss:
            best, best_miss = camera, miss
        if miss == 0.0:
            break
    assert best is not None
    return best


def _try_camera(rng: Rng, extent: Array, height: float) -> Camera:
    fov, look_down = float(rng.uniform(40, 60)), float(rng.uniform(13, 46))
    fill = rng.uniform(*FILL)
    tilt = float(rng.uniform(-0.07, 0.09)) * fov
    aside = rng.uniform(-0.13, 0.13)
    middle = np.array([0.0, 0.0, height + extent[2] / 2])
    distance = 2.0
    for _ in range(6):
        back = -direction(90.0, -look_down) * distance
        shift = aside * 2 * np.tan(np.deg2rad(fov) / 2) * distance
        x, y, z = (float(v) for v in middle + back + [shift, 0.0, 0.0])
        camera = Camera((x, y, z), look_down + tilt, fov)
        frame = project(camera, corners(extent, middle))
        tall, wide = np.ptp(frame[:, 1]), np.ptp(frame[:, 0])
        distance *= float(np.clip(max(tall / fill, wide / WIDEST), 0.5, 2.0))
    return camera


def corners(extent: Array, middle: Array) -> Array:
    """Return the eight corners, shape (8, 3), of a box of sides `extent` about `middle`."""
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return middle + signs * extent


def place_walls(rng: Rng, camera: Camera, extent: Array) -> tuple[Wall, ...]:
    """Draw no wall (outdoors), or one to three, with the camera and the object inside them."""
    count = int(rng.choice([0, 1, 2, 3], p=[0.15, 0.35, 0.35, 0.15]))
    turn = float(rng.uniform(-35, 35))
    sides = [90.0, *(float(a) for a in rng.permutation([0.0, 180.0]))][:count]
    height = float(rng.uniform(2.3, 3.2))
    same = wall_material(rng)
    reach = float(np.hypot(extent[0], extent[1])) / 2
    walls = []
    for side in sides:
        azimuth = (side + turn) % 360
        towards = direction(azimuth, 0.0)
        nearest = max(2.0, reach + 1.2, float(towards @ camera.position) + CAMERA_CLEARANCE)
        distance = nearest + float(rng.gamma(1.5, 0.6))
        material = same if rng.random() < 0.7 else wall_material(rng)
        walls.append(Wall(azimuth, distance, height, material))
    return tuple(walls)


def place_clutter(
    rng: Rng,
    camera: Camera,
    extent: Array,
    height: float,
    walls: Sequence[Wall],
    lights: Sequence[Light],
) -> tuple[Item, ...]:
    """Draw up to six background objects, none in the object's or a light's way."""
    wanted, placed, circles = int(rng.integers(0, 7)), [], []
    names = list(kinds.OBJECT_KINDS["train"])
    middle = np.array([0.0, 0.0, height + extent[2] / 2])
    subject_frame = project(camera, corners(extent, middle))
    subject_reach = float(np.hypot(extent[0], extent[1])) / 2
    for _ in range(4 * wanted):
        if len(placed) == wanted:
            break
        kind, seed = names[rng.integers(len(names))], int(rng.integers(2**31))
        size = float(rng.uniform(*kinds.SIZES.get(kind, kinds.DEFAULT_SIZE)))
        yaw = float(rng.uniform(-180, 180))
        shape = rest_and_scale(kinds.generator(kind)(np.random.default_rng(seed)), size)
        low, high = bounds(transform_all(shape, rotation("z", yaw)))
        sides = high - low
        reach = float(np.hypot(sides[0], sides[1])) / 2
        for _ in range(12):
            spot = np.array([rng.uniform(-3.5, 3.5), rng.uniform(-1.5, 4.5), 0.0])
            fits = (
                _inside(spot, reach, walls, camera)
                and np.hypot(*spot[:2]) > subject_reach + reach + 0.2
                and all(np.hypot(*(spot[:2] - p)) > r + reach + 0.05 for p, r in circles)
                and _in_view_behind(camera, spot + sides * [0, 0, 0.5], sides, subject_frame)
                and not any(
                    _shades(spot, reach + 0.6 * subject_reach, sides[2], middle, light)
                    for light in lights
                )
            )
            if fits:
                position = (float(spot[0]), float(spot[1]), 0.0)
                placed.append(Item(kind, seed, size, yaw, position, object_materials(rng)))
                circles.append((spot[:2], reach))
                break
    return tuple(placed)


def _inside(spot: Array, reach: float, walls: Sequence[Wall], camera: Camera) -> bool:
    clear = all(float(direction(w.azimuth, 0.0) @ spot) + reach < w.distance - 0.03 for w in walls)
    return clear and float(np.hypot(*(spot[:2] - camera.position[:2]))) > reach + 0.5


def _in_view_behind(camera: Camera, middle: Array, sides: Array, subject_frame: Array) -> bool:
    """Say whether a box shows in the frame without covering the subject's box from in front."""
    frame = project(camera, corners(sides, middle))
    if frame[:, 2].min() < 0.3:
        return False
    low, high = frame[:, :2].min(axis=0), frame[:, :2].max(axis=0)
    if (high < 0.05).any() or (low > 0.95).any():
        return False
    subject_low, subject_high = subject_frame[:, :2].min(axis=0), subject_frame[:, :2].max(axis=0)
    overlaps = bool((low < subject_high + 0.02).all() and (high > subject_low - 0.02).all())
    return not overlaps or frame[:, 2].min() > subject_frame[:, 2].max()


def _shades(spot: Array, reach: float, height: float, middle: Array, light: Light) -> bool:
    """Say whether an upright cylinder meets the cone from the subject's middle to a light."""
    along = np.linspace(0.0, 1.0, 40)[:, None]
    line = middle + along * (np.asarray(light.position) - middle)
    near = np.hypot(*(line[:, :2] - spot[:2]).T) < reach + light.radius * along[:, 0]
    return bool((near & (line[:, 2] - light.radius * along[:, 0] < height)).any())
