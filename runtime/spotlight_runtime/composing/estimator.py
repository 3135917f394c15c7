"""A photograph's albedo, normals and depth, by a network that is handed in.

The network sees the photograph at its own scale. What it says is brought back to the photograph's
pixels by a guided filter (He and Sun 2015, "Fast guided filter"): each map is locally linear in the
picture, so it follows the picture's edges. Albedo comes back through its opposite: the *shading*,
picture ÷ albedo, is what is smooth, so it is enlarged and the photograph divided by it keeps its
texture.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray, require_finite
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.imaging.colour import linear_to_srgb, luma
from spotlight_runtime.imaging.upsampling import magnify_rows
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.parallel import in_parallel
from spotlight_runtime.scenes.scene import Intrinsics

__all__ = ["DETAIL_SIDE", "estimate_intrinsics", "estimate_small", "follow_picture", "resized"]


WORKING_SIDE: Final = 384
"""Pixels of the longer side that the network sees, about what it was trained on."""
MULTIPLE: Final = 32
"""The network halves five times, so its sides are multiples of this."""
REACH: Final = 2
"""Radius of the guided filter in pixels of the network's scale."""
SMOOTHNESS: Final = np.float32(1e-3)
"""Variance of the guide below which the filter sees no edge."""
DARKEST: Final = np.float32(1e-3)
"""Linear light and albedo below which their quotient says nothing."""
BRIGHTEST: Final = np.float32(1e30)
"""Linear light beyond which that quotient may leave float32."""
NEAREST: Final = 1e-3
"""Least depth, in the network's units."""
DETAIL_SIDE: Final = 1024
"""Pixels of the longer side at which normals and depth follow the picture's edges: what a network
guesses from a third of that has no finer ones."""
TINY: Final = np.float32(1e-6)
STRIP_PIXELS: Final = 1 << 19


def estimate_intrinsics(network: Network, photograph: Photograph) -> Intrinsics:
    """Estimate albedo, normals and depth at the photograph's size.

    Parameters
    ----------
    network : callable
        ``network(image=(1, 3, h, w))["maps"]``: float32, (1, 7, h, w). The image is sRGB-encoded
        in [0, 1], with sides that are multiples of `MULTIPLE`; the maps are albedo in [0, 1],
        unit normals in camera space, and positive depth up to scale.
    photograph : Photograph

    Returns
    -------
    Intrinsics
        Depth is in the network's own unit.

    Raises
    ------
    NumericalError
        If the network says NaN or infinity.
    """
    small = estimate_small(network, photograph)
    picture = resized(photograph.radiance, small.albedo.shape[:2])
    normal, depth = _geometry(small, picture, photograph)
    return Intrinsics(albedo=_albedo(small, picture, photograph), normal=normal, depth=depth)


def estimate_small(network: Network, photograph: Photograph) -> Intrinsics:
    """Ask the network, at its own scale; see `estimate_intrinsics`.

    Returns
    -------
    Intrinsics
        Of shape (h, w), the photograph's shrunk to `WORKING_SIDE`.
    """
    height, width = photograph.size
    factor = min(1.0, WORKING_SIDE / max(height, width))
    high, wide = (max(MULTIPLE, round(s * factor / MULTIPLE) * MULTIPLE) for s in (height, width))
    picture = linear_to_srgb(resized(photograph.radiance, (high, wide)))
    image = np.ascontiguousarray(picture.transpose(2, 0, 1)[None])
    maps = np.asarray(network(image=image)["maps"], dtype=np.float32)
    require_finite(
        maps,
        f"{photograph.name}: estimating the maps",
        "give them instead (--albedo, --normal, --depth)",
    )
    planes = maps[0].transpose(1, 2, 0)
    # Squares of what a network may say are no float32.
    length = np.linalg.norm(planes[..., 3:6].astype(np.float64), axis=2, keepdims=True)
    return Intrinsics(
        albedo=np.clip(planes[..., :3], 0.0, 1.0),
        normal=(planes[..., 3:6] / np.maximum(length, TINY)).astype(np.float32),
        depth=np.maximum(planes[..., 6], np.float32(NEAREST)),
    )


def _albedo(small: Intrinsics, picture: FloatArray, photograph: Photograph) -> FloatArray:
    """Divide the photograph by its enlarged shading."""
    radiance = photograph.radiance
    shading = np.clip(picture, DARKEST, BRIGHTEST) / np.maximum(small.albedo, DARKEST)
    enlarged = follow_picture(np.log(shading), picture, radiance)
    albedo = np.empty_like(radiance)

    def fill(rows: slice) -> None:
        np.divide(radiance[rows], np.exp(enlarged(rows)), out=albedo[rows])
        # Where the picture is black it says nothing, and the network's guess is as good as 0.
        np.clip(albedo[rows], 0.0, 1.0, out=albedo[rows])

    height, width = photograph.size
    step = max(1, STRIP_PIXELS // width)
    in_parallel(fill, [slice(top, min(top + step, height)) for top in range(0, height, step)])
    return albedo


def _geometry(
    small: Intrinsics, picture: FloatArray, photograph: Photograph
) -> tuple[FloatArray, FloatArray]:
    """Normals and depth: to the picture's edges at `DETAIL_SIDE`, and smoothly from there."""
    assert small.normal is not None, "estimate_small gives all three"
    assert small.depth is not None, "estimate_small gives all three"
    height, width = photograph.size
    factor = min(1.0, DETAIL_SIDE / max(height, width))
    size = (max(1, round(height * factor)), max(1, round(width * factor)))
    detailed = resized(photograph.radiance, size)
    wanted = np.concatenate([small.normal, np.log(small.depth)[..., None]], axis=2)
    maps = follow_picture(wanted, picture, detailed)(slice(0, size[0]))
    length = np.linalg.norm(maps[..., :3], axis=2, keepdims=True)
    normal = maps[..., :3] / np.maximum(length, TINY)
    depth = np.exp(maps[..., 3])
    return (
        resized(np.ascontiguousarray(normal), photograph.size),
        resized(depth, photograph.size),
    )


def follow_picture(
    values: FloatArray, picture: FloatArray, radiance: FloatArray
) -> Callable[[slice], FloatArray]:
    """Enlarge maps so that they follow the edges of a picture.

    Parameters
    ----------
    values : ndarray of float32, shape (h, w, C)
        At the small scale.
    picture : ndarray of float32, shape (h, w, 3)
        The picture there, linear.
    radiance : ndarray of float32, shape (H, W, 3)
        The picture, linear.

    Returns
    -------
    callable
        Rows of the picture, a slice, → the maps there, float32, shape (rows, W, C).
    """
    guide = _guide(picture)
    mean = _box(guide)
    spread = np.maximum(_box(guide * guide) - mean * mean, 0.0)
    level = _box(values)
    slope = _box(values * guide[..., None]) - level * mean[..., None]
    slope /= (spread + SMOOTHNESS)[..., None]
    constant = _box(level - slope * mean[..., None])
    fit = np.concatenate([_box(slope), constant], axis=2).astype(np.float32)
    channels, size = values.shape[2], (radiance.shape[0], radiance.shape[1])

    def enlarged(rows: slice) -> FloatArray:
        large = magnify_rows(fit, rows.start, rows.stop, size)
        maps = large[..., :channels]
        maps *= _guide(radiance[rows])[..., None]
        maps += large[..., channels:]
        return maps

    return enlarged


def _box(array: FloatArray) -> FloatArray:
    side = 2 * REACH + 1
    return np.asarray(cv2.blur(array, (side, side), borderType=cv2.BORDER_REPLICATE))


def resized(image: FloatArray, size: tuple[int, ...]) -> FloatArray:
    """Resize an image of shape (H, W, C) to (h, w, C), averaging where it shrinks."""
    if image.shape[:2] == size:
        return image
    larger = size[0] > image.shape[0] or size[1] > image.shape[1]
    kind = cv2.INTER_LINEAR if larger else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, (size[1], size[0]), interpolation=kind))


def _guide(linear: FloatArray) -> FloatArray:
    """What edges are looked for in: luma, in steps about as large in shadow as in light."""
    return np.sqrt(luma(linear))
