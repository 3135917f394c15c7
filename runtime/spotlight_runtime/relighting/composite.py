"""From predictions to the picture: background preservation and colour balance (method §5).

Everything here works on encoded images in [0, 1], in the backbone's own encoding.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.diffusion.conditioning import dilate
from spotlight_runtime.imaging.colour import luma

__all__ = ["colour_balance", "compose_picture", "limit_to_region", "shadow_ratio"]


EPSILON: Final = 1e-6
REGION_BLUR: Final = 15
REGION_SIGMA: Final = 1.5
DARKEST_MEAN: Final = 1e-4
"""A prediction darker than this outside the object says nothing about colour."""


def shadow_ratio(predicted: FloatArray, no_shadow: FloatArray) -> FloatArray:
    """How much darker the shadow makes each pixel: ``clip((I_pred+ε)/(I_no_shadow+ε), 0, 1)``.

    Parameters
    ----------
    predicted, no_shadow : ndarray of float32, shape (H, W, 3)
        Predictions with and without the guiding shadow, from the same noise.

    Returns
    -------
    ndarray of float32, shape (H, W)
        In [0, 1].
    """
    quotient = (luma(predicted) + np.float32(EPSILON)) / (luma(no_shadow) + np.float32(EPSILON))
    return np.clip(quotient, 0.0, 1.0)


def limit_to_region(ratio: FloatArray, region: BoolArray) -> FloatArray:
    """Keep the ratio inside the shading-masked region only, over a soft border (ZeroComp).

    Outside the region (more than the 7 pixels of the 15×15, σ 1.5 Gaussian away) the ratio is
    exactly 1, so the background there is untouched to the bit.

    Parameters
    ----------
    ratio : ndarray of float32, shape (H, W)
    region : ndarray of bool, shape (H, W)

    Returns
    -------
    ndarray of float32, shape (H, W)
    """
    size = (REGION_BLUR, REGION_BLUR)
    weight = cv2.GaussianBlur(region.astype(np.float32), size, REGION_SIGMA)
    return np.float32(1.0) + np.clip(weight, 0.0, 1.0) * (ratio - np.float32(1.0))


def colour_balance(background: FloatArray, no_shadow: FloatArray, mask: FloatArray) -> FloatArray:
    """Per-channel factor k between the background and its prediction, outside the object.

    Parameters
    ----------
    background, no_shadow : ndarray of float32, shape (H, W, 3)
    mask : ndarray of float32, shape (H, W)
        Dilated object mask; pixels count by how much of them lies outside it.

    Returns
    -------
    ndarray of float32, shape (3,)
        1 where the object covers everything, or the prediction outside it is black.
    """
    outside = 1.0 - mask.astype(np.float64)
    total = float(outside.sum())
    if total < 1.0:
        return np.ones(3, dtype=np.float32)
    wanted = np.einsum("hwc,hw->c", background, outside) / total
    present = np.einsum("hwc,hw->c", no_shadow, outside) / total
    usable = present > DARKEST_MEAN
    return np.divide(wanted, present, out=np.ones(3), where=usable).astype(np.float32)


def compose_picture(
    background: FloatArray,
    predicted: FloatArray,
    no_shadow: FloatArray,
    object_mask: FloatArray,
    region: BoolArray | None,
) -> tuple[FloatArray, BoolArray]:
    """``out = k·pred·mask + background·(1−mask)·ratio``, mask being the dilated object mask.

    Parameters
    ----------
    background, predicted, no_shadow : ndarray of float32, shape (H, W, 3)
    object_mask : ndarray of float32, shape (H, W)
    region : ndarray of bool, shape (H, W), or None
        Where the background may darken (`limit_to_region`); None: everywhere, as the release.

    Returns
    -------
    image : ndarray of float32, shape (H, W, 3)
        In [0, 1].
    untouched : ndarray of bool, shape (H, W)
        Where the image is the background, bit for bit.
    """
    mask = dilate(object_mask)
    ratio = shadow_ratio(predicted, no_shadow)
    if region is not None:
        ratio = limit_to_region(ratio, region)
    balance = colour_balance(background, no_shadow, mask)
    kept = background * ((np.float32(1.0) - mask) * ratio)[..., None]
    image = np.clip(balance * predicted * mask[..., None] + kept, 0.0, 1.0)
    return image, (mask == 0.0) & (ratio == 1.0)
