"""Triangle meshes made of smooth or flat parts, in plain numpy.

Axes are the world's: x to the camera's right, y away from the camera, z up. Lengths are in metres
unless a generator says that its result is of unit size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Part:
    """One piece of surface with one material.

    Attributes
    ----------
    vertices, normals : float64 array, shape (N, 3)
        Positions and unit shading normals.
    uv : float64 array, shape (N, 2)
        Texture coordinates in the part's own units; `pack_uv` maps them into the unit square.
    faces : int64 array, shape (M, 3)
        Counter-clockwise seen from outside.
    slot : int
        Which of the item's materials this part wears.
    """

    vertices: Array
    faces: Array
    normals: Array
    uv: Array
    slot: int = 0


Shape = tuple[Part, ...]


def bounds(shape: Sequence[Part]) -> tuple[Array, Array]:
    """Return the lowest and highest corner of a shape, each of shape (3,)."""
    low = np.min([part.vertices.min(axis=0) for part in shape], axis=0)
    high = np.max([part.vertices.max(axis=0) for part in shape], axis=0)
    return low, high


def transform(
    part: Part, matrix: Array | None = None, offset: Sequence[float] = (0.0, 0.0, 0.0)
) -> Part:
    """Apply a 3x3 linear map and an offset to a part, normals included.

    A map that mirrors also turns the faces round, so that they still face outwards.
    """
    offset_array = np.asarray(offset, dtype=np.float64)
    if matrix is None:
        return replace(part, vertices=part.vertices + offset_array)
    vertices = part.vertices @ matrix.T + offset_array
    normals = _unit(part.normals @ np.linalg.inv(matrix))
    faces = part.faces[:, ::-1] if np.linalg.det(matrix) < 0 else part.faces
    return replace(part, vertices=vertices, normals=normals, faces=faces)


def transform_all(
    shape: Sequence[Part], matrix: Array | None = None, offset: Sequence[float] = (0.0, 0.0, 0.0)
) -> Shape:
    """Apply `transform` to every part of a shape."""
    return tuple(transform(part, matrix, offset) for part in shape)


def rotation(axis: str, degrees: float) -> Array:
    """Return the right-handed 3x3 rotation about a coordinate axis ('x', 'y' or 'z')."""
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = cosine
    matrix[first, second], matrix[second, first] = -sine, sine
    return matrix


def rest_and_scale(shape: Sequence[Part], size: float) -> Shape:
    """Scale a shape to `size` metres along its longest side and stand it over the origin."""
    low, high = bounds(shape)
    scale = size / float((high - low).max())
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return transform_all(shape, np.eye(3) * scale, -foot * scale)


def pack_uv(shape: Sequence[Part], extent: float) -> Shape:
    """Scale every part's texture coordinates by `1 / extent` and fold them into the unit square.

    A part is shifted as a whole, so a part that is larger than `extent` is shrunk instead of
    wrapped (an atlas tile cannot repeat).
    """
    packed = []
    for part in shape:
        low = part.uv.min(axis=0)
        span = max(float((part.uv.max(axis=0) - low).max()), 1e-9)
        scaled = (part.uv - low) / max(extent, span)
        packed.append(replace(part, uv=np.clip(scaled, 0.0, 1.0)))
    return tuple(packed)


def flat(vertices: Array, faces: Array, slot: int = 0) -> Part:
    """Build a faceted part.

    Every triangle gets its own corners, its plane's normal and box-projected uv.
    """
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(faces)]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    keep = np.linalg.norm(area, axis=1) > 1e-12
    corners, normal = corners[keep], _unit(area[keep])
    points = corners.reshape(-1, 3)
    normals = np.repeat(normal, 3, axis=0)
    return Part(
        points, np.arange(len(points)).reshape(-1, 3), normals, _box_uv(points, normals), slot
    )


def surface(points: Array, close_u: bool = False, close_v: bool = False, slot: int = 0) -> Part:
    """Build a smooth part from a grid of points, shape (U, V, 3).

    `close_u` and `close_v` say that the last row or column joins the first; they must then not be
    repeated in `points`. Normals are area weighted and continue across closed seams and poles;
    triangles of no area are left out. Texture coordinates follow the arc length along either
    direction.
    """
    grid = np.asarray(points, dtype=np.float64)
    if close_u:
        grid = np.concatenate([grid, grid[:1]], axis=0)
    if close_v:
        grid = np.concatenate([grid, grid[:, :1]], axis=1)
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    vertices = grid.reshape(-1, 3)
    area = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    keep = np.linalg.norm(area, axis=1) > 1e-14
    faces, area = faces[keep], area[keep]
    along_u = np.linalg.norm(np.diff(grid, axis=0), axis=2).mean(axis=1)
    along_v = np.linalg.norm(np.diff(grid, axis=1), axis=2).max(axis=0)
    u = np.concatenate([[0.0], np.cumsum(along_u)])
    v = np.concatenate([[0.0], np.cumsum(along_v)])
    uv = np.stack(np.meshgrid(v, u), axis=-1).reshape(-1, 2)
    return Part(vertices, faces, _smooth_normals(vertices, faces, area), uv, slot)


def _smooth_normals(vertices: Array, faces: Array, area: Array) -> Array:
    """Average area-weighted face normals over corners that share a position."""
    scale = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    keys = np.round(vertices / scale * 1e6).astype(np.int64)
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.reshape(-1)
    total = np.zeros((int(group.max()) + 1, 3))
    for corner in range(3):
        np.add.at(total, group[faces[:, corner]], area)
    return _unit(total[group])


def _box_uv(points: Array, normals: Array) -> Array:
    """Project points along the axis that each normal is closest to; returns shape (N, 2)."""
    axis = np.abs(normals).argmax(axis=1)
    across = np.where(axis == 0, 1, 0)
    up = np.where(axis == 2, 1, 2)
    rows = np.arange(len(points))
    return np.stack([points[rows, across], points[rows, up]], axis=1)


def _unit(vectors: Array) -> Array:
    """Normalise rows; a zero row becomes straight up, so that no NaN reaches the renderer."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), np.array([0.0, 0.0, 1.0]))
