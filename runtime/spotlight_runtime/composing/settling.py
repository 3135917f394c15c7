"""Estimated depth and normals brought to a floor that is known better than they are.

A small network's depth is right about what is in front of what, and wrong by a power: near and far
are drawn together or apart. The floor says by how much, for its depth follows from the camera's
height and tilt. After that what is nearly floor is floor, so that shadows lie flat on it, and what
would be below it is floor, too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.parallel import in_parallel
from spotlight_runtime.scenes.scene import Intrinsics

__all__ = ["settle"]


FIT_SIDE: Final = 256
"""Pixels of the longer side from which the power is found."""
FACING_UP: Final = 0.7
"""Cosine between an estimated normal and up from which a pixel may be floor."""
LOWEST_RAY: Final = 0.02
"""How far a ray has to fall over its depth for the floor there to be known."""
LEAST_FLOOR: Final = 0.02
"""Share of the picture that may be floor, below which only the scale is found."""
POWERS: Final = (0.5, 2.5)
ROUNDS: Final = 10
SURELY, BARELY = np.float32(0.12), np.float32(0.3)
"""Log depth before the floor's up to which what may be floor is floor, and from which not."""
STRIP_PIXELS: Final = 1 << 19


def settle(maps: Intrinsics, camera: Camera, ground: Ground) -> Intrinsics:
    """Bring estimated depth to metres over a floor, and what is nearly floor onto it.

    Parameters
    ----------
    maps : Intrinsics
        With normals and depth, the depth in any unit.
    camera : Camera
    ground : Ground
        In metres.

    Returns
    -------
    Intrinsics
    """
    assert maps.normal is not None, "estimated maps have all three"
    assert maps.depth is not None, "estimated maps have all three"
    scale, power = _calibration(maps.normal, maps.depth, camera, ground)
    old_normal, old_depth = maps.normal, maps.depth
    normal, depth = np.empty_like(old_normal), np.empty_like(old_depth)
    up = np.array(ground.normal, dtype=np.float32)

    def fill(rows: slice) -> None:
        logarithm = scale + power * np.log(old_depth[rows])
        falling = _falling(camera, ground, rows)
        if falling.max() <= LOWEST_RAY:  # above the horizon
            depth[rows], normal[rows] = np.exp(logarithm), old_normal[rows]
            return
        floor = np.log(np.float32(-ground.offset) / np.maximum(falling, np.float32(LOWEST_RAY)))
        above = floor - logarithm
        share = np.clip((BARELY - above) / (BARELY - SURELY), 0.0, 1.0)
        # What faces up and is little above the floor is floor; nothing is below it.
        share *= (old_normal[rows] @ up > FACING_UP) | (above < 0.0)
        share *= falling > LOWEST_RAY
        depth[rows] = np.exp(logarithm + share * (floor - logarithm))
        mixed = old_normal[rows] + share[..., None] * (up - old_normal[rows])
        length = np.sqrt(np.einsum("hwc,hwc->hw", mixed, mixed))
        np.divide(mixed, np.maximum(length, np.float32(1e-6))[..., None], out=normal[rows])

    step = max(1, STRIP_PIXELS // camera.width)
    tops = range(0, camera.height, step)
    in_parallel(fill, [slice(top, min(top + step, camera.height)) for top in tops])
    return replace(maps, normal=normal, depth=depth)


def _calibration(
    normal: FloatArray, depth: FloatArray, camera: Camera, ground: Ground
) -> tuple[np.float32, np.float32]:
    """Logarithm of the scale, and the power, that take estimated depth to the floor's.

    A line through log depths by reweighted least squares with Tukey's weights.
    """
    factor = min(1.0, FIT_SIDE / max(camera.width, camera.height))
    small = Camera(
        max(1, round(camera.width * factor)),
        max(1, round(camera.height * factor)),
        camera.field_of_view,
    )
    size = (small.width, small.height)
    facing, near = (cv2.resize(m, size, interpolation=cv2.INTER_NEAREST) for m in (normal, depth))
    falling = _falling(small, ground, slice(0, small.height))
    known = falling > LOWEST_RAY
    floor = known & (facing @ np.array(ground.normal, dtype=np.float32) > FACING_UP)
    enough = floor.mean() > LEAST_FLOOR
    if not enough:
        floor = known if known.any() else np.ones_like(known)
    x = np.log(near[floor]).astype(np.float64)
    y = np.log(-ground.offset / np.maximum(falling[floor], LOWEST_RAY)).astype(np.float64)
    power, scale = 1.0, float(np.median(y - x))
    for _ in range(ROUNDS if enough else 0):
        off = y - scale - power * x
        width = max(6.9 * float(np.median(np.abs(off))), 1e-6)
        weight = np.maximum(1.0 - (off / width) ** 2, 0.0) ** 2
        middle, level = np.average(x, weights=weight), np.average(y, weights=weight)
        variance = float((weight * (x - middle) ** 2).sum())
        slope = float((weight * (x - middle) * (y - level)).sum()) / max(variance, 1e-12)
        power = float(np.clip(slope, *POWERS))
        scale = float(level - power * middle)
    return np.float32(scale), np.float32(power)


def _falling(camera: Camera, ground: Ground, rows: slice) -> FloatArray:
    """How far rays fall towards the floor by the time they reach depth 1, shape (rows, W)."""
    x, y, z = ground.normal
    across = (np.arange(camera.width) + 0.5 - 0.5 * camera.width) / camera.focal
    down = (0.5 * camera.height - np.arange(rows.start, rows.stop) - 0.5) / camera.focal
    return (z - x * across[None, :] - y * down[:, None]).astype(np.float32)
