"""Which way is up, from the edges of walls, doors and posts: their lines meet in one point.

In pictures of what people build this is the surest sign of how the camera was held. Of 108 views
of nine panoramas, looking down by 10 and by 25 degrees, it answered for 76, with a median error of
0.5 degrees and nine in ten within 3; planes fitted to a small network's depth were 15 off.
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.imaging.colour import linear_to_srgb, luma

__all__ = ["up_from_verticals"]


SIDE: Final = 800
"""Pixels of the longer side in which lines are looked for."""
SHORTEST: Final = 0.03
"""Of a line, as a share of the longer side."""
STEEPEST_TILT: Final = 40.0
"""Degrees from the picture's vertical that an upright edge may lean."""
MOST_ROLL: Final = 10.0
"""Degrees the camera is taken to roll at most."""
PITCHES: Final = (-25.0, 50.0)
"""Degrees the camera may look down."""
TOLERANCE: Final = math.sin(math.radians(1.0))
"""Sine of the angle between a line and the direction it counts for."""
PAIRS: Final = 1000
"""Pairs of lines tried, always the same: a third of the lines upright would do with fifty."""
REFINEMENTS: Final = 5
FEWEST: Final = 6
ENOUGH: Final = 1.0
"""Picture heights of agreeing lines, at least; with less the answer is as often wrong as right."""


def up_from_verticals(photograph: Photograph) -> tuple[float, float, float] | None:
    """Find the vertical direction of a photograph.

    Returns
    -------
    (x, y, z) or None
        Unit vector in camera space; None where too few edges agree.
    """
    planes, lengths = _lines(photograph)
    if len(lengths) < FEWEST:
        return None
    rng = np.random.default_rng(0)
    pairs = rng.choice(len(lengths), (PAIRS, 2), p=lengths / lengths.sum())
    # Two lines' planes meet in the direction of both.
    found = np.cross(planes[pairs[:, 0]], planes[pairs[:, 1]])
    found = found[np.linalg.norm(found, axis=1) > TOLERANCE]
    found = _upward(found)
    if not len(found):
        return None
    up = found[_agreement(planes, lengths, found).sum(axis=1).argmax()]
    for _ in range(REFINEMENTS):
        weights = _agreement(planes, lengths, up[None])[0]
        spread = (planes * weights[:, None]).T @ planes
        up = _upward(np.linalg.eigh(spread)[1][:, :1].T, limited=False)[0]
    agreeing = _agreement(planes, lengths, up[None])[0]
    still_upright = len(_upward(up[None])) == 1
    if not still_upright or (agreeing > 0).sum() < FEWEST or agreeing.sum() < ENOUGH:
        return None
    x, y, z = (float(value) for value in up)
    return x, y, z


def _lines(photograph: Photograph) -> tuple[FloatArray, FloatArray]:
    """Near-upright lines: normals of their planes through the camera, lengths in heights."""
    height, width = photograph.size
    factor = min(1.0, SIDE / max(height, width))
    camera = Camera(round(width * factor), round(height * factor), photograph.field_of_view)
    size = (camera.width, camera.height)
    small = cv2.resize(photograph.radiance, size, interpolation=cv2.INTER_AREA)
    grey = np.rint(linear_to_srgb(luma(small)) * np.float32(255.0)).astype(np.uint8)
    detected = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(grey)[0]
    if detected is None:
        return np.zeros((0, 3)), np.zeros(0)
    ends = detected.reshape(-1, 2, 2).astype(np.float64)
    across, down = np.abs(ends[:, 1] - ends[:, 0]).T
    length = np.hypot(across, down)
    upright = across < math.tan(math.radians(STEEPEST_TILT)) * down
    ends, length = (v[upright & (length > SHORTEST * max(size))] for v in (ends, length))
    rays = np.full((len(ends), 2, 3), -1.0)
    rays[..., 0] = (ends[..., 0] - 0.5 * camera.width) / camera.focal
    rays[..., 1] = (0.5 * camera.height - ends[..., 1]) / camera.focal
    planes = np.cross(rays[:, 0], rays[:, 1])
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    return planes, length / camera.height


def _upward(directions: FloatArray, limited: bool = True) -> FloatArray:
    """Unit vectors that point up, and of these only such as a person would hold a camera by."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    unit = unit * np.where(unit[:, 1:2] < 0.0, -1.0, 1.0)
    if not limited:
        return unit
    roll = np.degrees(np.arctan2(unit[:, 0], unit[:, 1]))
    pitch = np.degrees(np.arctan2(unit[:, 2], unit[:, 1]))
    held = (np.abs(roll) < MOST_ROLL) & (pitch > PITCHES[0]) & (pitch < PITCHES[1])
    return unit[held]


def _agreement(planes: FloatArray, lengths: FloatArray, directions: FloatArray) -> FloatArray:
    """Length of each line, less the further it points elsewhere, shape (directions, lines)."""
    off = (directions @ planes.T) / TOLERANCE
    return np.maximum(1.0 - off * off, 0.0) * lengths
