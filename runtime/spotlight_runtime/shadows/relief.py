"""A caster for objects without a mesh: what their depth map shows, given a back.

The back is guessed: a cross-section as deep as it is wide, that is, round. At each pixel the depth
is the chord of the largest disc that fits into the mask around it, so a leg gets the depth of a leg
and a seat that of a seat. Against the true shadows of rendered objects this did better than a flat
card, a constant thickness, or closing the object at its farthest visible point.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.diffusion.conditioning import align_depth
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.scenes.scene import Scene
from spotlight_runtime.shadows.receiver import Receiver

__all__ = ["relief_mesh"]


_CELLS: Final = 256
"""Along the longer side of the object: its outline stays within a pixel at 512 pixels."""
_COVERED: Final = 0.5
_TOUCHING: Final = 1.0
"""Percent of an object without a footprint that may sink into the background: noise in depth."""
_NEAREST: Final = np.float32(0.5)
"""Of its depth: how far an object without a footprint may be pulled towards the camera."""
_WHOLE: Final = 0.99
"""Coverage from which a pixel's depth is the object's own: along the outline it is mixed with what
lies behind, by metres."""


def relief_mesh(scene: Scene, receiver: Receiver, ground: Ground | None) -> ObjectMesh:
    """Build a closed mesh from the object's mask and depth.

    Parameters
    ----------
    scene : Scene
        Its object's depth is aligned to the background's by the footprint, as the renderer's
        conditioning is, or else moved along the rays until it touches the background. An object
        without depth becomes a card that stands upright where its mask ends below.
    receiver : Receiver
        The background's surface.
    ground : Ground or None

    Returns
    -------
    ObjectMesh

    Raises
    ------
    InvalidInputError
        If the mask covers nothing.
    """
    solid = scene.object_mask > _COVERED
    if not solid.any():
        raise InvalidInputError(
            "object_mask: expected a mask that covers a part of the picture, got one that is "
            "empty; without it (or object_mesh) nothing casts a shadow"
        )
    front = _front(scene, receiver, ground, solid)
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    box = slice(top, bottom), slice(left, right)
    step = max(1, -(-max(bottom - top, right - left) // _CELLS))
    cells, depth = _shrink(solid[box], front[box], step)
    chord = _chord(cells) * np.float32(step / scene.camera.focal)
    if scene.footprint_depth is None and scene.object_maps.depth is not None:
        seen = receiver.inverse_depth[box] > 0.0
        behind = 1.0 / np.where(seen, receiver.inverse_depth[box], 1.0)
        room = _room(cells, depth * (1.0 + chord), _shrink(seen, behind, step))
        # A guessed back that is deeper than the room must not push the front onto the camera.
        depth = depth + max(room, -_NEAREST * np.float32(depth[cells].min()))
    nearest = float(depth[cells].min())
    if nearest <= 0.0:
        raise InvalidInputError(
            f"object depth: expected it in front of the camera, got {nearest:.3g} where it is "
            "aligned to the background; check the depth maps' units"
        )
    rays = _corner_rays(scene.camera, int(top), int(left), step, cells)
    layers = [_at_corners(cells, side)[..., None] * rays for side in (depth, depth * (1.0 + chord))]
    return _compact(np.concatenate([layer.reshape(-1, 3) for layer in layers]), _faces(cells))


def _front(scene: Scene, receiver: Receiver, ground: Ground | None, solid: BoolArray) -> FloatArray:
    """Depth of the object's visible side in the background's unit, shape (H, W)."""
    depth, background = scene.object_maps.depth, scene.background_maps.depth
    if depth is None:
        return _card(receiver, ground, solid)
    mask = scene.object_mask
    scale, shift = 1.0, 0.0
    if background is not None and scene.footprint_depth is not None:
        scale, shift = align_depth(depth, mask, background, scene.footprint_depth)
    aligned: FloatArray = scale * depth / np.maximum(mask, _COVERED) + shift
    return _nearest(aligned, mask >= _WHOLE, solid)


def _room(
    cells: BoolArray, deepest: FloatArray, background: tuple[BoolArray, FloatArray]
) -> np.float32:
    """How far the object can move away along the rays until it touches the background."""
    known = cells & background[0]
    gaps = (background[1] - deepest)[known]
    return np.float32(np.percentile(gaps, _TOUCHING) if len(gaps) else 0.0)


def _nearest(values: FloatArray, trusted: BoolArray, wanted: BoolArray) -> FloatArray:
    """Replace values that are not trusted by that of the nearest pixel which is."""
    if not (trusted & wanted).any():
        return values
    rows, columns = np.nonzero(wanted)  # only there, or a photograph would take seconds
    box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    sources = (trusted & wanted)[box]
    _, labels = cv2.distanceTransformWithLabels(
        (~sources).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    by_label = np.zeros(int(labels.max()) + 1, dtype=values.dtype)
    by_label[labels[sources]] = values[box][sources]
    result = values.copy()
    result[box] = by_label[labels]
    return result


def _card(receiver: Receiver, ground: Ground | None, solid: BoolArray) -> FloatArray:
    """An upright plane through the lowest point of the mask."""
    row = int(np.flatnonzero(solid.any(axis=1))[-1])
    column = int(np.median(np.flatnonzero(solid[row])))
    inverse = float(receiver.inverse_depth[row, column])
    if inverse <= 0.0:
        raise InvalidInputError(
            "object: expected a floor under the lowest point of its mask, got sky or unknown "
            "depth; move the object or give its depth"
        )
    rays = receiver.camera.rays()
    facing = np.array([0.0, 0.0, -1.0]) if ground is None else ground.world_axes()[1]
    towards = rays @ facing.astype(np.float32)
    contact = float(towards[row, column]) / inverse
    return np.divide(contact, towards, out=np.full_like(towards, 1.0 / inverse), where=towards > 0)


def _shrink(solid: BoolArray, depth: FloatArray, step: int) -> tuple[BoolArray, FloatArray]:
    """Blocks of pixels: covered where at least half are, with the mean depth of those that are.

    Where no block is, those that are covered at all.
    """
    grow = [(0, -side % step) for side in solid.shape]
    blocks = [
        np.pad(array, grow)
        .reshape(-(-solid.shape[0] // step), step, -(-solid.shape[1] // step), step)
        .sum(axis=(1, 3))
        for array in (solid.astype(np.float32), np.where(solid, depth, 0.0))
    ]
    covered = blocks[0] >= _COVERED * step**2
    covered = covered if covered.any() else blocks[0] > 0.0
    mean = np.divide(blocks[1], blocks[0], out=np.zeros_like(blocks[1]), where=blocks[0] > 0)
    return covered, mean


def _chord(cells: BoolArray) -> FloatArray:
    """Depth of a round body with this outline, in cells, shape (H, W)."""
    padded = np.pad(cells, 1).astype(np.uint8)
    inset = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) - 0.5 * padded
    radius = np.zeros_like(inset)
    peaks = (inset >= cv2.dilate(inset, np.ones((3, 3), np.uint8))) & (padded > 0)
    rows, columns = np.nonzero(peaks)
    for i in np.argsort(inset[rows, columns]):  # larger discs over smaller ones
        size = float(inset[rows[i], columns[i]])
        centre = (int(columns[i]), int(rows[i]))
        cv2.circle(radius, centre, int(np.ceil(size)), size, thickness=cv2.FILLED)
    radius = np.maximum(radius, inset)
    chord = 2.0 * np.sqrt(np.maximum(inset * (2.0 * radius - inset), 0.0))
    return np.asarray(chord[1:-1, 1:-1] * cells, dtype=np.float32)


def _at_corners(cells: BoolArray, values: FloatArray) -> FloatArray:
    """Mean of the covered cells around each corner, shape (H + 1, W + 1); 0 where there are none.

    The mesh's outline is the cells' own, not drawn in by half of one.
    """
    total = _around(np.where(cells, values, 0.0))
    count = _around(cells.astype(np.float64))
    return np.divide(total, count, out=np.zeros_like(total), where=count > 0)


def _around(values: FloatArray) -> FloatArray:
    padded = np.pad(values.astype(np.float64), 1)
    return padded[:-1, :-1] + padded[:-1, 1:] + padded[1:, :-1] + padded[1:, 1:]


def _faces(cells: BoolArray) -> npt.NDArray[np.int32]:
    """Triangles of front, back and rim over the corners of covered cells."""
    height, width = cells.shape
    corner = np.arange((height + 1) * (width + 1), dtype=np.int32).reshape(height + 1, width + 1)
    behind = corner.size
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = [np.stack([a, c, b], -1)[cells], np.stack([b, c, d], -1)[cells]]
    faces += [face[:, ::-1] + behind for face in faces]
    outer = np.pad(cells, 1)
    # Against the front's own direction, so that every edge has one triangle on each side.
    sides = (
        (outer[:-2, 1:-1], a, b),
        (outer[2:, 1:-1], d, c),
        (outer[1:-1, :-2], c, a),
        (outer[1:-1, 2:], b, d),
    )
    for neighbour, start, end in sides:
        edge = cells & ~neighbour
        p, q = start[edge], end[edge]
        faces += [np.stack([p, q, p + behind], -1), np.stack([q, q + behind, p + behind], -1)]
    return np.concatenate(faces).astype(np.int32)


def _corner_rays(camera: Camera, top: int, left: int, step: int, cells: BoolArray) -> FloatArray:
    """Rays through the corners of the cells, shape (H + 1, W + 1, 3)."""
    height, width = cells.shape
    x = (left + step * np.arange(width + 1) - 0.5 * camera.width) / camera.focal
    y = (0.5 * camera.height - top - step * np.arange(height + 1)) / camera.focal
    return np.stack(np.broadcast_arrays(x, y[:, None], -1.0), axis=-1)


def _compact(vertices: FloatArray, faces: npt.NDArray[np.int32]) -> ObjectMesh:
    """Drop the vertices that no face uses."""
    used, index = np.unique(faces, return_inverse=True)
    return ObjectMesh(
        vertices[used].astype(np.float32), index.reshape(faces.shape).astype(np.int32)
    )
