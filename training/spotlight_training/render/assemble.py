"""Turns a scene description into arrays.

A background mesh, a subject mesh and one texture atlas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from . import kinds
from .atlas import Atlas, Tile
from .description import Item, Material, Panel, SceneDescription, Wall, direction
from .external import load_object
from .mesh import Array, Part, Shape, flat, pack_uv, rest_and_scale, rotation, transform_all
from .patterns import bake
from .solids import box

FLOOR_CELL = 6.0
FLOOR_CELLS = 7
WALL_WIDTH = 14.0
SINK = 2e-4
"""Metres by which an object is pressed into its support, so that no light leaks through the
contact."""


@dataclass(frozen=True)
class Geometry:
    """A triangle soup ready for the renderer: float32 (N, 3), (N, 3), (N, 2) and uint32 (M, 3)."""

    vertices: Array
    normals: Array
    uv: Array
    faces: Array


@dataclass(frozen=True)
class Assembly:
    """Everything the renderer traces.

    The scene without the object, the object, and their shared texture.
    """

    background: Geometry
    subject: Geometry
    atlas: Array


def assemble(scene: SceneDescription, objects: Path | None = None) -> Assembly:
    """Build all meshes and textures of a scene.

    Parameters
    ----------
    scene : SceneDescription
    objects : Path, optional
        Folder of external objects; needed where an item's kind is `file:NAME`.
    """
    atlas = Atlas()
    shared: dict[tuple[Material, float, bool], Tile] = {}
    background: list[Part] = [_floor(atlas, scene.floor, scene.floor_yaw)]
    background += [_wall(atlas, wall) for wall in scene.walls]
    # The subject asks first, so that it always gets the large tiles.
    subject = _item(atlas, shared, scene.subject, objects, closeup=True)
    for panel in scene.panels:
        background += _panel(atlas, shared, panel, closeup=max(panel.size[:2]) < 3.0)
    for item in scene.clutter:
        background += _item(atlas, shared, item, objects, closeup=False)
    return Assembly(_soup(background), _soup(subject), atlas.image)


def item_shape(item: Item) -> Shape:
    """Return a generated item's parts in world coordinates (untextured: uv in metres)."""
    shape = rest_and_scale(kinds.generator(item.kind)(np.random.default_rng(item.seed)), item.size)
    return transform_all(
        shape, rotation("z", item.yaw), np.asarray(item.position) - [0.0, 0.0, SINK]
    )


def _item(
    atlas: Atlas,
    shared: dict[tuple[Material, float, bool], Tile],
    item: Item,
    objects: Path | None,
    closeup: bool,
) -> list[Part]:
    if item.kind.startswith("file:"):
        return _file_item(atlas, item, objects)
    extent = 1.1 * item.size
    parts = []
    for part in pack_uv(item_shape(item), extent):
        material = item.materials[part.slot % len(item.materials)]
        tile = _tile(atlas, shared, material, extent, closeup)
        parts.append(replace(part, uv=tile.place(part.uv)))
    return parts


def _file_item(atlas: Atlas, item: Item, objects: Path | None) -> list[Part]:
    if objects is None:
        raise ValueError(
            f"objects: the scene uses {item.kind!r} but no folder was given. Pass --objects DIR."
        )
    shape, surfaces = load_object(objects / item.kind.removeprefix("file:"))
    standing = transform_all(
        rest_and_scale(shape, item.size),
        rotation("z", item.yaw),
        np.asarray(item.position) - [0.0, 0.0, SINK],
    )
    tiles = []
    for surface in surfaces:
        tile = atlas.large()
        atlas.paint(tile, surface.albedo, surface.roughness, surface.metallic)
        tiles.append(tile)
    return [replace(part, uv=tiles[part.slot].place(part.uv)) for part in standing]


def _panel(
    atlas: Atlas, shared: dict[tuple[Material, float, bool], Tile], panel: Panel, closeup: bool
) -> list[Part]:
    extent = max(panel.size)
    tile = _tile(atlas, shared, panel.material, extent, closeup)
    boxes = transform_all(
        pack_uv(box(panel.size), extent), rotation("z", panel.yaw), panel.position
    )
    return [replace(part, uv=tile.place(part.uv)) for part in boxes]


def _tile(
    atlas: Atlas,
    shared: dict[tuple[Material, float, bool], Tile],
    material: Material,
    extent: float,
    closeup: bool,
) -> Tile:
    key = (material, extent, closeup)
    if key not in shared:
        tile = atlas.large() if closeup else atlas.small()
        _bake(atlas, tile, material, (extent, extent))
        shared[key] = tile
    return shared[key]


def _bake(atlas: Atlas, tile: Tile, material: Material, extent: tuple[float, float]) -> None:
    albedo, gloss = bake(
        material.pattern,
        material.seed,
        np.asarray(material.colours),
        material.period,
        (tile.side, tile.side),
        extent,
    )
    atlas.paint(tile, albedo, material.roughness * gloss, material.metallic)


def _floor(atlas: Atlas, material: Material, yaw: float) -> Part:
    """Return a floor of mirrored cells, so that one tile covers 42 m without a seam."""
    tile = atlas.floor()
    _bake(atlas, tile, material, (FLOOR_CELL, FLOOR_CELL))
    half = FLOOR_CELLS / 2
    quads, uvs = [], []
    for i in range(FLOOR_CELLS):
        for j in range(FLOOR_CELLS):
            x, y = (i - half) * FLOOR_CELL, (j - half) * FLOOR_CELL
            quads.append(
                [
                    [x, y, 0],
                    [x + FLOOR_CELL, y, 0],
                    [x + FLOOR_CELL, y + FLOOR_CELL, 0],
                    [x, y + FLOOR_CELL, 0],
                ]
            )
            left, low = float(i % 2), float(j % 2)
            uvs.append([[left, low], [1 - left, low], [1 - left, 1 - low], [left, 1 - low]])
    turned = np.array(quads) @ rotation("z", yaw).T
    return _quads(turned, tile.place(np.array(uvs).reshape(-1, 2)))


def _wall(atlas: Atlas, wall: Wall) -> Part:
    tile = atlas.wall()
    _bake(atlas, tile, wall.material, (wall.height, WALL_WIDTH))
    towards, along = direction(wall.azimuth, 0.0), direction(wall.azimuth - 90.0, 0.0)
    left = towards * wall.distance - along * WALL_WIDTH / 2
    right = left + along * WALL_WIDTH
    up = np.array([0.0, 0.0, wall.height])
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float64)
    return _quads(np.array([[left, right, right + up, left + up]]), tile.place(uv))


def _quads(corners: Array, uv: Array) -> Part:
    """Return a faceted part of quads, shape (Q, 4, 3), with one uv a corner, shape (4Q, 2)."""
    order = np.array([0, 1, 2, 0, 2, 3])
    faces = (np.arange(len(corners))[:, None] * 4 + order).reshape(-1, 3)
    part = flat(corners.reshape(-1, 3), faces)
    return replace(part, uv=uv[faces.reshape(-1)])


def _soup(parts: Sequence[Part]) -> Geometry:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return Geometry(
        vertices=np.concatenate([part.vertices for part in parts]).astype(np.float32),
        normals=np.concatenate([part.normals for part in parts]).astype(np.float32),
        uv=np.concatenate([part.uv for part in parts]).astype(np.float32),
        faces=np.concatenate(
            [part.faces + start for part, start in zip(parts, starts, strict=True)]
        ).astype(np.uint32),
    )
