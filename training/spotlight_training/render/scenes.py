"""Draws a whole scene from (split, seed).

Support and object first, then camera, room, lights and clutter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from . import kinds
from .description import (
    FORMAT_VERSION,
    Ambient,
    Item,
    Light,
    Panel,
    SceneDescription,
    Wall,
    direction,
)
from .materials import (
    floor_material,
    light_colour,
    object_materials,
    sky_colours,
)
from .mesh import Array, bounds, rest_and_scale, rotation, transform_all
from .staging import place_camera, place_clutter, place_walls

Rng = np.random.Generator

EVALUATION_AZIMUTHS = tuple(range(0, 360, 45))
EVALUATION_ELEVATION = 45.0
LIGHT_CLEARANCE = 0.7
"""Metres from a light's centre to any wall: nearer ones burn a white patch into it."""
TRUTH, OPPOSITE = "gt_dir", "gt_dir_opposite"
"""The random dominant direction of an evaluation scene, and the light across the object that its
negative shadow needs."""


@dataclass(frozen=True)
class SceneOptions:
    """What a caller may choose about the scenes.

    Attributes
    ----------
    lights : int
        Dominant lights in a training scene.
    evaluation : bool
        Instead, eight azimuths at 45 degrees of elevation (`0000` to `0007`), a random direction
        (`gt_dir`) and its opposite.
    use_hdris : bool
        Draw ambient light from the split's HDR panoramas as well as from gradient skies.
    file_extents : mapping of str to (x, y, z)
        Bounding-box sides of external objects in metres, by file name. Those of the scene's split
        (`kinds.file_split`) make up half of its scenes.
    """

    lights: int = 4
    evaluation: bool = False
    use_hdris: bool = True
    file_extents: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)


def describe(split: str, seed: int, options: SceneOptions | None = None) -> SceneDescription:
    """Draw the scene of a split and seed; the same arguments always give an equal description.

    Raises
    ------
    ValueError
        If the split is unknown or has none of the external objects, or the seed is negative.
    """
    options = options or SceneOptions()
    if split not in kinds.SPLITS:
        raise ValueError(f"split: expected one of {', '.join(kinds.SPLITS)}; got {split!r}.")
    if seed < 0:
        raise ValueError(
            f"seed: expected 0 or more, got {seed}. Choose a --first-seed of 0 or more."
        )
    # Each part draws from a stream of its own, so that changing one leaves the others as they were.
    streams = np.random.default_rng([kinds.SPLITS.index(split), seed]).spawn(5)
    subject_rng, room_rng, light_rng, clutter_rng, ambient_rng = streams
    kind, item_seed, size, yaw = _choose_subject(subject_rng, split, options)
    extent = item_extent(kind, item_seed, size, yaw, options.file_extents)
    support, height = _support(room_rng, kind, extent)
    subject = Item(kind, item_seed, size, yaw, (0.0, 0.0, height), object_materials(subject_rng))
    camera = place_camera(subject_rng, extent, height)
    floor = floor_material(room_rng)
    floor_yaw = float(room_rng.uniform(0, 180))
    walls = place_walls(room_rng, camera, extent)
    lights = _lights(light_rng, extent, height, walls, options)
    clutter = place_clutter(clutter_rng, camera, extent, height, walls, lights)
    return SceneDescription(
        version=FORMAT_VERSION,
        split=split,
        seed=seed,
        camera=camera,
        lights=lights,
        ambient=_ambient(ambient_rng, split, options),
        floor=floor,
        floor_yaw=floor_yaw,
        walls=walls,
        panels=(*support, *_wall_panels(room_rng, walls)),
        clutter=clutter,
        subject=subject,
        support_height=height,
    )


def item_extent(
    kind: str,
    seed: int,
    size: float,
    yaw: float,
    file_extents: Mapping[str, tuple[float, float, float]],
) -> Array:
    """Return the bounding-box sides, shape (3,), in metres, of an item after its yaw."""
    if kind.startswith("file:"):
        sides = np.asarray(file_extents[kind.removeprefix("file:")])
        sides = sides * size / sides.max()
        turn = np.abs(rotation("z", yaw))
        return turn @ sides
    shape = rest_and_scale(kinds.generator(kind)(np.random.default_rng(seed)), size)
    low, high = bounds(transform_all(shape, rotation("z", yaw)))
    return high - low


def _choose_subject(rng: Rng, split: str, options: SceneOptions) -> tuple[str, int, float, float]:
    """Return the inserted object's kind, seed, size in metres and yaw in degrees."""
    names = list(kinds.OBJECT_KINDS[split])
    weights = np.array([kinds.KIND_WEIGHTS.get(name, 1.0) for name in names])
    kind = names[rng.choice(len(names), p=weights / weights.sum())]
    size = float(rng.uniform(*kinds.SIZES.get(kind, kinds.DEFAULT_SIZE)))
    files = _files(split, options)
    if files and rng.random() < 0.5:
        kind = f"file:{files[rng.integers(len(files))]}"
        own = max(options.file_extents[kind.removeprefix("file:")])
        # Sample models come in centimetres and worse; only believable sizes are kept.
        size = own if 0.2 <= own <= 1.8 else size
    furniture = kind in kinds.FLOOR_ONLY
    yaw = (
        float(np.clip(rng.normal(0.0, 45.0), -150, 150))
        if furniture
        else float(rng.uniform(-180, 180))
    )
    return kind, int(rng.integers(2**31)), size, yaw


def _files(split: str, options: SceneOptions) -> list[str]:
    """Return the external objects of a split, by file name."""
    splits = {name: kinds.file_split(name) for name in sorted(options.file_extents)}
    files = [name for name, own in splits.items() if own == split]
    if splits and not files:
        counts = ", ".join(f"{each} {[*splits.values()].count(each)}" for each in kinds.SPLITS)
        raise ValueError(
            f"objects: expected some of split {split!r} by the hash of their names, got {counts}. "
            "Add objects, rename one, or leave out --objects for this split."
        )
    return files


def _support(rng: Rng, kind: str, extent: Array) -> tuple[tuple[Panel, ...], float]:
    """Return what the object stands on (or nothing) and its height in metres."""
    draw = rng.random()
    small = float(extent.max()) < 0.7 and kind not in kinds.FLOOR_ONLY
    yaw = float(rng.uniform(-30, 30))
    margin = float(rng.uniform(0.35, 0.9))
    width, depth = float(extent[0]) + margin, float(extent[1]) + margin
    if draw < 0.15:
        rug = (width + 0.6, depth + 0.6, 0.012)
        return (Panel((0.0, 0.0, 0.006), rug, yaw, _cloth(rng)),), 0.012
    if not small or draw > 0.5:
        return (), 0.0
    height = float(rng.uniform(0.2, 0.65))
    offset = (float(rng.uniform(-0.2, 0.2)) * margin, float(rng.uniform(-0.2, 0.2)) * margin)
    top_material, leg_material = object_materials(rng, metal_chance=0.0)[:2]
    if draw < 0.3:
        return (Panel((*offset, height / 2), (width, depth, height), yaw, top_material),), height
    parts = [Panel((*offset, height - 0.02), (width, depth, 0.04), yaw, top_material)]
    turn = rotation("z", yaw)[:2, :2]
    for corner in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        x, y = turn @ (np.array(corner) * [width / 2 - 0.05, depth / 2 - 0.05]) + offset
        leg = (float(x), float(y), (height - 0.04) / 2)
        parts.append(Panel(leg, (0.06, 0.06, height - 0.04), yaw, leg_material))
    return tuple(parts), height


def _cloth(rng: Rng):  # noqa: ANN202 - a Material; the loop below only filters what object_materials draws
    cloths = [m for m in object_materials(rng, metal_chance=0.0) if m.roughness >= 0.5]
    return cloths[0] if cloths else floor_material(rng)


def _wall_panels(rng: Rng, walls: tuple[Wall, ...]) -> list[Panel]:
    """Return skirting boards and pictures for some walls."""
    panels = []
    board = object_materials(rng, metal_chance=0.0)[0]
    skirting = rng.random() < 0.6
    for wall in walls:
        turn = rotation("z", wall.azimuth)
        yaw = wall.azimuth - 90.0
        if skirting:
            centre = turn @ [wall.distance - 0.008, 0.0, 0.045]
            panels.append(Panel(_point(centre), (10.0, 0.016, 0.09), yaw, board))
        if rng.random() < 0.4:
            width, height = rng.uniform(0.3, 0.9, 2)
            centre = turn @ [wall.distance - 0.012, rng.uniform(-1.2, 1.2), rng.uniform(0.9, 1.5)]
            picture = object_materials(rng, metal_chance=0.0)[0]
            panels.append(Panel(_point(centre), (float(width), 0.024, float(height)), yaw, picture))
    return panels


def _lights(
    rng: Rng, extent: Array, height: float, walls: tuple[Wall, ...], options: SceneOptions
) -> tuple[Light, ...]:
    """Return the dominant lights, each pulled in until it hangs inside every wall."""
    if options.evaluation:
        directions = [
            (f"{i:04d}", float(a), EVALUATION_ELEVATION) for i, a in enumerate(EVALUATION_AZIMUTHS)
        ]
        azimuth, elevation = float(rng.uniform(0, 360)), _elevation(rng)
        directions += [
            (TRUTH, azimuth, elevation),
            (OPPOSITE, (azimuth + 180.0) % 360.0, elevation),
        ]
    else:
        # Spread round the circle, so that the lightings of one scene differ as much as they can.
        start, step = rng.uniform(0, 360), 360.0 / options.lights
        directions = [
            (
                f"{i:04d}",
                float((start + (i + rng.uniform(-0.4, 0.4)) * step) % 360),
                _elevation(rng),
            )
            for i in range(options.lights)
        ]
    middle = np.array([0.0, 0.0, height + extent[2] / 2])
    lights = []
    for name, azimuth, elevation in directions:
        distance = float(rng.uniform(2.0, 5.0))
        radius = float(np.exp(rng.uniform(np.log(0.05), np.log(0.6))))
        towards = direction(azimuth, elevation)
        for wall in walls:
            approach = float(towards @ direction(wall.azimuth, 0.0))
            if approach > 0:
                distance = min(distance, (wall.distance - LIGHT_CLEARANCE) / approach)
        # Clear of the object, whose half diagonal it must stay outside of, and of the floor.
        radius = min(
            radius,
            0.2 * distance,
            LIGHT_CLEARANCE - 0.05,
            max(distance - float(np.linalg.norm(extent)) / 2 - 0.05, 0.05),
        )
        position = middle + distance * towards
        radius = min(radius, 0.9 * float(position[2]))
        lights.append(
            Light(name, azimuth, elevation, distance, radius, light_colour(rng), _point(position))
        )
    return tuple(lights)


def _elevation(rng: Rng) -> float:
    return float(np.clip(rng.normal(42.0, 17.0), 15.0, 75.0))


def _ambient(rng: Rng, split: str, options: SceneOptions) -> Ambient:
    weight = float(np.exp(rng.uniform(np.log(0.12), np.log(0.6))))
    rotation_degrees = float(rng.uniform(0, 360))
    colours = sky_colours(rng)
    names = kinds.HDRIS[split]
    name = names[rng.integers(len(names))]
    if options.use_hdris and rng.random() < 0.75:
        return Ambient("hdri", name, rotation_degrees, colours, weight)
    return Ambient("sky", "", rotation_degrees, colours, weight)


def _point(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
