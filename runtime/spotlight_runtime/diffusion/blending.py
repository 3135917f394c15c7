"""Blending the guiding shadow into the latents (paper §3.2, eq. 1, and its supplement)."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray

__all__ = [
    "add_noise",
    "blend_shadow",
    "downsample_antialiased",
    "downsample_bilinear",
    "latent_shadow_mask",
]


BINARISE_AT = 0.05
EDGE_WEIGHT = 2.0


def add_noise(clean: FloatArray, noise: FloatArray, alpha_bar: float) -> FloatArray:
    """``noise(Z, t) = √ᾱ_t·Z + √(1−ᾱ_t)·ε``: clean latents at the noise level of ᾱ."""
    return math.sqrt(alpha_bar) * clean + math.sqrt(1.0 - alpha_bar) * noise


def blend_shadow(
    z: FloatArray, noised_composite: FloatArray, mask: FloatArray, beta: float
) -> FloatArray:
    """Eq. 1: ``z̃ = (1 − βm)·z + βm·noise(E(g), t)``.

    Parameters
    ----------
    z : ndarray of float32, shape (branches, C, h, w)
        Latents after a step.
    noised_composite : ndarray of float32, shape (branches, C, h, w)
        Encoded rough composite of each branch, at the noise level of the blend.
    mask : ndarray of float32, shape (branches, 1, h, w)
        `latent_shadow_mask` of each branch, in [0, 2].
    beta : float
        Shadow latent weight β in [0, 1]; 0.05 in the paper.

    Returns
    -------
    ndarray of float32, shape (branches, C, h, w)
    """
    weight = np.minimum(beta * mask, np.float32(1.0))
    return (1.0 - weight) * z + weight * noised_composite


def weight_of_steps(beta: float, usual: int, steps: int) -> float:
    """β for another number of steps than it is meant for.

    After every step but the last a share β of the latents is replaced, so fewer steps at the same
    β leave more of the picture without its shadow: of a full shadow 62 % are put in by the paper's
    twenty steps, by two of them 5 %. This weight replaces as much in all:
    ``(1 − weight)^(steps − 1) = (1 − β)^(usual − 1)``.

    Parameters
    ----------
    beta : float
        Shadow latent weight in [0, 1] at ``usual`` steps.
    usual, steps : int
        From 1; where either is 1 there is no blend to compare, and β is the weight.

    Returns
    -------
    float
        In [0, 1].
    """
    if usual == steps or min(usual, steps) < 2:
        return beta
    return 1.0 - (1.0 - beta) ** ((usual - 1) / (steps - 1))


def latent_shadow_mask(
    guiding_shadow: FloatArray, object_mask: FloatArray, downscale: int
) -> FloatArray:
    """Where and how strongly the shadow enters the latents (supplement; method steps 1 to 4).

    Both masks are downsampled bilinearly and binarised at 0.05; a 3×3 cross splits the shadow into
    inside (weight 1) and edge (dilation minus erosion, weight 2, so that its softness survives);
    the object is cut out, so the shadow never leaks into it.

    Parameters
    ----------
    guiding_shadow : ndarray of float32, shape (H, W)
        In [0, 1], 1 = fully shadowed.
    object_mask : ndarray of float32, shape (H, W)
        Object coverage in [0, 1].
    downscale : int
        Pixels per latent; H and W are multiples of it.

    Returns
    -------
    ndarray of float32, shape (H / downscale, W / downscale)
        Values 0, 1 or 2, to be weighted by β.
    """
    shadow = (downsample_bilinear(guiding_shadow, downscale) > BINARISE_AT).astype(np.uint8)
    covered = downsample_bilinear(object_mask, downscale) > BINARISE_AT
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    inside = cv2.erode(shadow, cross).astype(np.float32)
    edge = cv2.dilate(shadow, cross).astype(np.float32) - inside
    return (inside + np.float32(EDGE_WEIGHT) * edge) * ~covered


def downsample_bilinear(image: FloatArray, downscale: int) -> FloatArray:
    """Bilinear samples at the latent centres, without antialiasing (half-pixel centres).

    For an even factor that is the mean of the 2×2 pixels around each centre.
    """
    if downscale == 1:
        return image
    if downscale % 2:
        return image[downscale // 2 :: downscale, downscale // 2 :: downscale]
    low, high = downscale // 2 - 1, downscale // 2
    rows = image[low::downscale] + image[high::downscale]
    return np.float32(0.25) * (rows[:, low::downscale] + rows[:, high::downscale])


def downsample_antialiased(image: FloatArray, downscale: int) -> FloatArray:
    """Bilinear downsampling with a triangle filter two latents wide, normalised at the borders.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
    downscale : int
        H and W are multiples of it.

    Returns
    -------
    ndarray of float32, shape (H / downscale, W / downscale)
        Within the range of the input.
    """
    small = _triangle_rows(image.astype(np.float64), downscale)
    return _triangle_rows(small.T, downscale).T.astype(np.float32)


def _triangle_rows(image: npt.NDArray[np.float64], downscale: int) -> npt.NDArray[np.float64]:
    """Weighted means of the rows within ``downscale`` of each latent's centre.

    Sums of two blocks each, not a product of matrices: that went to BLAS, whose threads spin for a
    while once they are done, on the cores that the networks are to have next.
    """
    before = downscale // 2
    rising = (np.arange(downscale) + (1.0 if downscale % 2 else 0.5)) / downscale

    def summed(rows: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        padded = np.pad(rows, ((before, downscale - before), (0, 0)))
        blocks = padded.reshape(-1, downscale, rows.shape[1])
        rise = np.einsum("kdw,d->kw", blocks, rising)
        fall = np.einsum("kdw,d->kw", blocks, 1.0 - rising)
        return np.asarray(rise[:-1] + fall[1:])

    return summed(image) / summed(np.ones((len(image), 1)))
