"""The maps of a product as the camera sees it: antialiased, premultiplied, without its light.

Every pixel that an edge may cross (of the silhouette, of a surface, of what is painted on it) is
seen through 4×4 rays on a regular grid; inside a smooth surface one ray and a texture averaged over
the pixel give the same. So a large product in a large photograph costs about as much as it covers
pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.composing.product import Product, weld
from spotlight_runtime.composing.surfaces import (
    ALBEDO,
    ALPHA,
    DEPTH,
    METALLIC,
    NORMAL,
    ROUGHNESS,
    Tracer,
)
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.parallel import in_parallel
from spotlight_runtime.scenes.scene import Intrinsics

__all__ = ["GBuffer", "image_box", "render_gbuffer"]


GRID: Final = 4
"""Rays across an edge pixel, in x and in y."""
RAYS_AT_ONCE: Final = 1 << 17
"""A ray and its surface take some 300 bytes."""
EDGE_COSINE: Final = np.float32(np.cos(np.radians(8.0)))
"""Neighbouring normals further apart than this are antialiased."""
EDGE_ALBEDO: Final = np.float32(0.08)
"""Neighbouring albedos that differ by more are antialiased."""
LONGEST_RIM: Final = 1 << 14
"""Steps along an edge of the mesh; a longer one reaches far outside the picture."""
HIDDEN: Final = 1.01
"""A rim that is deeper than what is seen there by this is behind it."""


@dataclass(frozen=True, slots=True, eq=False)
class GBuffer:
    """A product's maps at the photograph's size.

    Attributes
    ----------
    maps : Intrinsics
        All five, premultiplied by the mask; normals are unit vectors times it.
    mask : ndarray of float32, shape (H, W)
        Coverage in [0, 1].
    box : (top, bottom, left, right)
        Outside it everything is 0.
    """

    maps: Intrinsics
    mask: FloatArray
    box: tuple[int, int, int, int]


def image_box(points: FloatArray, camera: Camera) -> tuple[int, int, int, int]:
    """Rows [top, bottom) and columns [left, right) of the image that points fall into.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Camera space, all in front of the camera.
    """
    placed = camera.project(points)
    left, top = np.floor(placed[:, :2].min(axis=0)).astype(int) - 1
    right, bottom = np.ceil(placed[:, :2].max(axis=0)).astype(int) + 1
    return (
        int(np.clip(top, 0, camera.height)),
        int(np.clip(bottom, 0, camera.height)),
        int(np.clip(left, 0, camera.width)),
        int(np.clip(right, 0, camera.width)),
    )


def render_gbuffer(product: Product, camera: Camera) -> GBuffer:
    """Look at a product through a camera.

    Parameters
    ----------
    product : Product
        Vertices and normals in camera space, everything in front of the camera.
    camera : Camera

    Returns
    -------
    GBuffer
        Empty where the product lies outside the image.
    """
    size = (camera.height, camera.width)
    # Untouched zeros take no memory, so maps of the photograph's size cost what the box does.
    maps = Intrinsics(
        albedo=np.zeros((*size, 3), np.float32),
        normal=np.zeros((*size, 3), np.float32),
        depth=np.zeros(size, np.float32),
        roughness=np.zeros(size, np.float32),
        metallic=np.zeros(size, np.float32),
    )
    mask = np.zeros(size, np.float32)
    box = image_box(product.vertices[np.unique(product.faces)], camera)
    top, bottom, left, right = box
    buffer = GBuffer(maps, mask, box)
    if top >= bottom or left >= right:
        return buffer
    tracer = Tracer(product)
    rows, columns = np.mgrid[top:bottom, left:right]
    pixels = np.stack([columns.reshape(-1), rows.reshape(-1)], axis=1)

    def look(chunk: slice, grid: int) -> npt.NDArray[np.int32]:
        return _fill(buffer, tracer, camera, pixels[chunk], grid)

    faces = in_parallel(lambda chunk: look(chunk, 1), _chunks(len(pixels), RAYS_AT_ONCE))
    edges = _edges(buffer, np.concatenate(faces).reshape(rows.shape))
    edges |= _visible_rims(buffer, product, camera)
    pixels = pixels[edges.reshape(-1)]
    in_parallel(lambda chunk: look(chunk, GRID), _chunks(len(pixels), RAYS_AT_ONCE // GRID**2))
    return buffer


def _fill(
    buffer: GBuffer, tracer: Tracer, camera: Camera, pixels: npt.NDArray[np.intp], grid: int
) -> npt.NDArray[np.int32]:
    """See pixels, given as (x, y) rows, through grid × grid rays each, and write their maps.

    Returns the triangle on each ray.
    """
    offsets = (np.arange(grid) + 0.5) / grid
    x = (pixels[:, 0, None, None] + offsets - 0.5 * camera.width) / camera.focal
    y = (0.5 * camera.height - pixels[:, 1, None, None] - offsets[:, None]) / camera.focal
    directions = np.full((len(pixels), grid, grid, 3), -1.0, dtype=np.float32)
    directions[..., 0], directions[..., 1] = x, y
    seen, faces = tracer.look(directions.reshape(-1, 3), 1.0 / (camera.focal * grid))
    mean = seen
    if grid > 1:
        mean = seen.reshape(len(pixels), grid * grid, -1).mean(axis=1)
    at = (pixels[:, 1], pixels[:, 0])
    # The mean of unit normals is shorter; a normal map's consumers expect the direction.
    length = np.linalg.norm(mean[:, NORMAL], axis=1)
    factor = np.divide(mean[:, ALPHA], length, out=np.zeros_like(length), where=length > 0.0)
    maps = buffer.maps
    maps.albedo[at] = mean[:, ALBEDO]
    for value, channel in (
        (maps.normal, mean[:, NORMAL] * factor[:, None]),
        (maps.depth, mean[:, DEPTH]),
        (maps.roughness, mean[:, ROUGHNESS]),
        (maps.metallic, mean[:, METALLIC]),
    ):
        if value is not None:
            value[at] = channel
    buffer.mask[at] = mean[:, ALPHA]
    return faces


def _edges(buffer: GBuffer, faces: npt.NDArray[np.int32]) -> BoolArray:
    """Pixels of the box that see another surface than a neighbour, or something transparent."""
    top, bottom, left, right = buffer.box
    crop = np.s_[top:bottom, left:right]
    mask, albedo = buffer.mask[crop], buffer.maps.albedo[crop]
    assert buffer.maps.normal is not None, "rendered with every map"
    normal = buffer.maps.normal[crop]
    edges = (mask > 0.0) & (mask < 1.0)
    for ahead, behind in (
        (np.s_[1:], np.s_[:-1]),
        (np.s_[:, 1:], np.s_[:, :-1]),
    ):
        differs = mask[ahead] != mask[behind]
        # Texture inside one triangle is averaged by its coarser levels.
        y, x = np.nonzero((faces[ahead] != faces[behind]) & ~differs)
        one, two = normal[ahead][y, x], normal[behind][y, x]
        bent = np.einsum("kc,kc->k", one, two) < EDGE_COSINE
        painted = np.abs(albedo[ahead][y, x] - albedo[behind][y, x]).max(axis=1) > EDGE_ALBEDO
        differs[y, x] = bent | painted
        edges[ahead] |= differs
        edges[behind] |= differs
    return edges


def _visible_rims(buffer: GBuffer, product: Product, camera: Camera) -> BoolArray:
    """Pixels of the box on a rim that is not behind something else.

    One ray a pixel misses parts thinner than that; their rims do not.
    """
    top, bottom, left, right = buffer.box
    assert buffer.maps.depth is not None, "rendered with every map"
    depth = buffer.maps.depth[top:bottom, left:right]
    found = np.zeros(depth.shape, dtype=np.uint8)
    # Seen through holes: the farthest of the pixels around, and everything beside the object.
    behind = cv2.dilate(np.where(depth > 0.0, depth, np.inf), np.ones((3, 3), np.uint8))
    ends = camera.project(product.vertices[_rims(product)].reshape(-1, 3)).reshape(-1, 2, 3)
    ends -= np.array([left, top, 0.0])
    length = np.abs(ends[:, 1, :2] - ends[:, 0, :2]).max(axis=1)
    steps = np.clip(np.ceil(length), 1, LONGEST_RIM).astype(np.intp) + 1
    for chunk in _groups(steps, RAYS_AT_ONCE):
        count = steps[chunk]
        edge = np.repeat(np.arange(len(count)), count)
        within = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
        share = (within / (count[edge] - 1))[:, None]
        # Straight lines stay straight in the picture; it is 1 / depth that runs evenly along them.
        line = ends[chunk].copy()
        line[..., 2] = 1.0 / line[..., 2]
        point = line[edge, 0] * (1.0 - share) + line[edge, 1] * share
        x, y = np.floor(point[:, 0]).astype(np.intp), np.floor(point[:, 1]).astype(np.intp)
        inside = (x >= 0) & (x < depth.shape[1]) & (y >= 0) & (y < depth.shape[0])
        x, y, near = x[inside], y[inside], 1.0 / point[inside, 2]
        seen = near <= behind[y, x] * HIDDEN
        found[y[seen], x[seen]] = 1
    return cv2.dilate(found, np.ones((3, 3), np.uint8)) > 0


def _rims(product: Product) -> npt.NDArray[np.int32]:
    """Edges, shape (R, 2), between a face towards the camera and one away from it, or at an end."""
    corners = product.vertices[product.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = np.einsum("fc,fc->f", across, corners[:, 0]) < 0.0
    place = weld(product.vertices)[product.faces]
    ends = np.stack([place, np.roll(place, -1, axis=1)], axis=2).reshape(-1, 2)
    key = ends.min(axis=1) * np.int64(len(product.vertices)) + ends.max(axis=1)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(first, append=len(order))
    facing = np.add.reduceat(np.repeat(towards, 3)[order].astype(np.int64), first)
    chosen = order[first[(count != 2) | (facing == 1)]]
    tail, head = product.faces.reshape(-1), np.roll(product.faces, -1, axis=1).reshape(-1)
    return np.stack([tail[chosen], head[chosen]], axis=1)


def _groups(counts: npt.NDArray[np.intp], size: int) -> Iterator[slice]:
    """Consecutive stretches whose counts add up to about a size."""
    bins = np.cumsum(counts) // size
    starts = np.flatnonzero(np.diff(bins, prepend=-1))
    for start, stop in zip(starts, [*starts[1:], len(counts)]):
        yield slice(start, stop)


def _chunks(count: int, size: int) -> Iterator[slice]:
    for start in range(0, count, size):
        yield slice(start, start + size)
