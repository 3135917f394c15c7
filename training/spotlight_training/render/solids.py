"""Solids that object generators are assembled from.

Boxes, surfaces of revolution, prisms, tubes and displaced spheres.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from .mesh import Array, Part, Shape, flat, rotation, surface, transform, transform_all

Vector = Sequence[float]


def box(size: Vector, centre: Vector = (0.0, 0.0, 0.0), slot: int = 0) -> Shape:
    """Return a sharp-edged box of the given (x, y, z) size about a centre."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array(
        [triangle for q in quads for triangle in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
    )
    return (flat(corners * np.asarray(size) + np.asarray(centre), faces, slot),)


def rounded_box(
    size: Vector, radius: float, centre: Vector = (0.0, 0.0, 0.0), slot: int = 0, segments: int = 4
) -> Shape:
    """Return a box whose edges are rounded with `radius` (capped at 49 % of the thinnest side)."""
    half = np.asarray(size, dtype=np.float64) / 2
    radius = min(radius, 0.98 * float(half.min()))
    arc = np.tan(np.linspace(0.0, np.pi / 4, segments + 1))
    line = np.concatenate([-arc[::-1], arc])
    side = np.concatenate([-np.ones(segments + 1), np.ones(segments + 1)])
    u, v = np.meshgrid(line, line, indexing="ij")
    side_u, side_v = np.meshgrid(side, side, indexing="ij")
    parts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            order = [(axis + 1) % 3, (axis + 2) % 3]
            direction = np.empty((*u.shape, 3))
            core = np.empty_like(direction)
            direction[..., axis], direction[..., order[0]], direction[..., order[1]] = sign, u, v
            core[..., axis], core[..., order[0]], core[..., order[1]] = sign, side_u, side_v
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            points = core * (half - radius) + radius * direction
            if sign < 0:
                points, direction = points[::-1], direction[::-1]
            patch = surface(points + np.asarray(centre), slot=slot)
            # The patch's own averages stop at its border; the sphere's direction is exact there.
            parts.append(
                Part(patch.vertices, patch.faces, direction.reshape(-1, 3), patch.uv, slot)
            )
    return tuple(parts)


def lathe(profile: Array, slot: int = 0, segments: int = 40, crease: float = 35.0) -> Shape:
    """Turn a profile of (radius, height) points, bottom to top, round the z axis.

    Where the profile bends by more than `crease` degrees the surface gets an edge; elsewhere it is
    smooth. A profile that begins and ends on the axis (radius 0) gives a closed solid.
    """
    profile = np.asarray(profile, dtype=np.float64)
    steps = np.diff(profile, axis=0)
    profile = profile[np.concatenate([[True], np.linalg.norm(steps, axis=1) > 1e-9])]
    angles = np.unwrap(np.arctan2(*np.diff(profile, axis=0).T[::-1]))
    breaks = np.flatnonzero(np.abs(np.rad2deg(np.diff(angles))) > crease) + 1
    edges = [0, *breaks.tolist(), len(profile) - 1]
    turn = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    parts = []
    for first, last in pairwise(edges):
        strip = profile[first : last + 1]
        rings = np.concatenate(
            [
                strip[None, :, :1] * circle[:, None, :],
                np.broadcast_to(strip[None, :, 1:], (segments, len(strip), 1)),
            ],
            axis=-1,
        )
        parts.append(surface(rings, close_u=True, slot=slot))
    return tuple(parts)


def cylinder(
    radius: float, height: float, base: Vector = (0.0, 0.0, 0.0), slot: int = 0, segments: int = 24
) -> Shape:
    """Return a capped cylinder standing at `base`."""
    return frustum(radius, radius, height, base, slot, segments)


def frustum(
    bottom: float,
    top: float,
    height: float,
    base: Vector = (0.0, 0.0, 0.0),
    slot: int = 0,
    segments: int = 24,
) -> Shape:
    """Return a capped cone frustum standing at `base`, with the given bottom and top radii."""
    profile = np.array([[0.0, 0.0], [bottom, 0.0], [top, height], [0.0, height]])
    return transform_all(lathe(profile, slot, segments), offset=base)


def rod(start: Vector, end: Vector, radius: float, slot: int = 0, segments: int = 14) -> Shape:
    """Return a capped cylinder between two points."""
    start_array, end_array = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    axis = end_array - start_array
    length = float(np.linalg.norm(axis))
    return transform_all(
        cylinder(radius, length, slot=slot, segments=segments), _frame_along(axis), start_array
    )


def beam(start: Vector, end: Vector, width: float, depth: float, slot: int = 0) -> Shape:
    """Return a square-section beam between two points."""
    start_array, end_array = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    axis = end_array - start_array
    length = float(np.linalg.norm(axis))
    return transform_all(
        box((width, depth, length), slot=slot), _frame_along(axis), (start_array + end_array) / 2
    )


def ellipsoid(
    radii: Vector, centre: Vector = (0.0, 0.0, 0.0), slot: int = 0, segments: int = 28
) -> Shape:
    """Return an ellipsoid with the given (x, y, z) radii."""
    part = surface(_sphere_grid(segments, segments // 2 + 1), close_u=True, slot=slot)
    return (transform(part, np.diag(np.asarray(radii, dtype=np.float64)), centre),)


def tube(
    path: Array, radius: Array | float, closed: bool, slot: int = 0, segments: int = 16
) -> Shape:
    """Sweep a circle along a path of shape (N, 3); open tubes get flat caps.

    `radius` may be one number or one a path point.
    """
    path = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), (len(path),))
    ahead = np.roll(path, -1, axis=0) - path
    if not closed:
        ahead[-1] = ahead[-2]
    tangents = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross(tangents[0], [0.0, 0.0, 1.0] if abs(tangents[0][2]) < 0.9 else [1.0, 0.0, 0.0])
    turn = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    rings = np.empty((len(path), segments, 3))
    for i, tangent in enumerate(tangents):
        side = side - tangent * (side @ tangent)
        side /= np.linalg.norm(side)
        across = np.cross(tangent, side)
        rings[i] = path[i] + radii[i] * (
            np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * across
        )
    skin = surface(rings.transpose(1, 0, 2), close_u=True, close_v=closed, slot=slot)
    if closed:
        return (skin,)
    fan = np.array([[0, i, i + 1] for i in range(1, segments - 1)])
    return (skin, flat(rings[0], fan[:, ::-1], slot), flat(rings[-1], fan, slot))


def prism(
    outline: Array, depth: float, kernel: Vector = (0.0, 0.0), slot: int = 0, bevel: float = 0.0
) -> Shape:
    """Extrude a counter-clockwise outline of (x, z) points along y, centred on y = 0.

    The outline must be star-shaped about `kernel` (every point of it visible from there), which is
    what lets the caps be fans. `bevel` shrinks the caps towards the kernel by that fraction over
    that fraction of the depth.
    """
    outline = np.asarray(outline, dtype=np.float64)
    middle = np.asarray(kernel, dtype=np.float64)
    inner = middle + (outline - middle) * (1.0 - bevel)
    shoulder = depth * (0.5 - bevel)
    rings = [(inner, -depth / 2), (outline, -shoulder), (outline, shoulder), (inner, depth / 2)]
    if bevel == 0.0:
        rings = [rings[0], rings[3]]
    count = len(outline)
    points = np.concatenate([np.insert(ring, 1, y, axis=1) for ring, y in rings])
    faces = []
    for ring in range(len(rings) - 1):
        here, there = ring * count, (ring + 1) * count
        for i in range(count):
            j = (i + 1) % count
            faces += [(here + i, here + j, there + j), (here + i, there + j, there + i)]
    centres = np.array([[middle[0], -depth / 2, middle[1]], [middle[0], depth / 2, middle[1]]])
    last = (len(rings) - 1) * count
    for i in range(count):
        j = (i + 1) % count
        faces += [(len(points), j, i), (len(points) + 1, last + i, last + j)]
    # Counter-clockwise in (x, z) is clockwise seen along +y, hence the turn.
    return (flat(np.concatenate([points, centres]), np.array(faces)[:, ::-1], slot),)


def displaced_sphere(
    displacement: Array, stretch: Vector = (1.0, 1.0, 1.0), slot: int = 0
) -> Shape:
    """Return a sphere whose radius is multiplied by `displacement`, shape (U, V).

    U round the axis, V pole to pole.
    """
    points = (
        _sphere_grid(*displacement.shape)
        * displacement[..., None]
        * np.asarray(stretch, dtype=np.float64)
    )
    return (surface(points, close_u=True, slot=slot),)


def sphere_directions(around: int, down: int) -> Array:
    """Return the directions, shape (around, down, 3), that `displaced_sphere` displaces."""
    return _sphere_grid(around, down)


def _sphere_grid(around: int, down: int) -> Array:
    turn = np.linspace(0.0, 2 * np.pi, around, endpoint=False)[:, None]
    polar = np.linspace(np.pi, 0.0, down)[None, :]
    ring = np.sin(polar)
    ring[:, [0, -1]] = (
        0.0  # sin(pi) is not quite 0, and poles must be one point for the normals to join
    )
    return np.stack(
        [np.cos(turn) * ring, np.sin(turn) * ring, np.broadcast_to(np.cos(polar), (around, down))],
        -1,
    )


def _frame_along(axis: Array) -> Array:
    """Return a rotation that takes z to `axis`."""
    z = axis / np.linalg.norm(axis)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def turned(shape: Shape, axis: str, degrees: float) -> Shape:
    """Return the shape rotated about a coordinate axis."""
    return transform_all(shape, rotation(axis, degrees))
