"""Which pixels a shadow can reach at all, so that no ray is cast for the others."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.shadows.placement import ObjectBox, PlacedLight
from spotlight_runtime.shadows.receiver import Receiver

__all__ = ["reachable"]


_LATTICE: Final = 128
"""Pixels along the longer side that are tested; those between follow their neighbours."""
_STEEPEST: Final = 0.05
"""Cosine below which a surface seen at a grazing angle counts as this steep."""


def reachable(
    receiver: Receiver, light: PlacedLight, box: ObjectBox, object_mask: FloatArray
) -> npt.NDArray[np.int64]:
    """Pixels from which the object's bounding box may hide a part of the light.

    Parameters
    ----------
    receiver : Receiver
    light : PlacedLight
    box : ObjectBox
    object_mask : ndarray of float32, shape (H, W)

    Returns
    -------
    ndarray of int64, shape (P,)
        Flat indices, in order; none fully under the object, and none where nothing receives.
    """
    height, width = receiver.inverse_depth.shape
    step = -(-max(height, width) // _LATTICE)
    rows = np.minimum(np.arange(0, height, step) + step // 2, height - 1)
    columns = np.minimum(np.arange(0, width, step) + step // 2, width - 1)
    lattice = (rows[:, None] * width + columns).ravel()
    near = _near_the_box(receiver, lattice, light, box, step).reshape(len(rows), len(columns))
    grown = cv2.dilate(near.astype(np.uint8), np.ones((3, 3), np.uint8))
    reached = np.repeat(np.repeat(grown, step, axis=0), step, axis=1)[:height, :width] > 0
    return np.flatnonzero(reached & (receiver.inverse_depth > 0.0) & (object_mask < 1.0))


def _near_the_box(
    receiver: Receiver,
    pixels: npt.NDArray[np.int64],
    light: PlacedLight,
    box: ObjectBox,
    step: int,
) -> BoolArray:
    """Whether the way to the light meets the box, grown by what light and pixel are wide there."""
    inverse = receiver.inverse_depth.ravel()[pixels]
    seen = inverse > 0.0
    patch = receiver.patch(pixels[seen])
    axes = box.axes.astype(np.float32)
    points = np.einsum("pc,kc->pk", patch.points(), axes) - box.centre.astype(np.float32)
    beyond = np.linalg.norm(points, axis=1) + np.float32(np.linalg.norm(box.half))
    towards = (axes @ light.centre).astype(np.float32)
    if light.directional:
        directions: FloatArray = np.broadcast_to(towards, points.shape)
        spread, reach = light.radius * beyond, np.inf
    else:
        directions = towards - box.centre.astype(np.float32) - points
        distance = np.linalg.norm(directions, axis=1)
        spread, reach = light.radius * np.minimum(beyond / np.maximum(distance, 1e-9), 1.0), 1.0
    slant = np.abs(np.einsum("pc,pc->p", patch.normals, patch.rays))
    slant = np.maximum(slant / np.linalg.norm(patch.rays, axis=1), _STEEPEST)
    grow = spread + step * patch.pixel / (patch.inverse_depth * slant)
    result = np.zeros(len(pixels), dtype=np.bool_)
    result[seen] = _meets(points, directions, box.half + grow[:, None], reach)
    return result


def _meets(points: FloatArray, directions: FloatArray, half: FloatArray, reach: float) -> BoolArray:
    """Whether segments meet boxes about the origin (the slab test), shape (P,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-half - points) / directions, (half - points) / directions
    # A direction along a slab gives ±inf outside of it, and NaN only on its face: either will do.
    near, far = np.fmin(first, second), np.fmax(first, second)
    # Columns against each other: a reduction over three values a row takes numpy ten times as long.
    enter = np.maximum(np.maximum(near[:, 0], near[:, 1]), near[:, 2])
    leave = np.minimum(np.minimum(far[:, 0], far[:, 1]), far[:, 2])
    return np.asarray((enter <= leave) & (leave >= 0.0) & (enter <= reach))
