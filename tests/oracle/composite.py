"""From two predictions to the image: the background preservation of ZeroComp and of the release."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from .masks import square_dilation

LUMA = (0.299, 0.587, 0.114)
INTENSITY_FLOOR = 1e-6


def intensity(image: Tensor) -> Tensor:
    """I(x) = 0.299·R + 0.587·G + 0.114·B of a (3, H, W) image."""
    return sum(weight * channel for weight, channel in zip(LUMA, image))[None]


def shadow_ratio(predicted: Tensor, no_shadow: Tensor) -> Tensor:
    """How much darker the shadow makes each pixel, in [0, 1]."""
    quotient = (intensity(predicted) + INTENSITY_FLOOR) / (intensity(no_shadow) + INTENSITY_FLOOR)
    return quotient.clamp(0.0, 1.0)


def gaussian_blur(mask: Tensor, size: int = 15, sigma: float = 1.5) -> Tensor:
    """A (1, H, W) mask under a normalised size×size Gaussian, its border mirrored."""
    x = torch.arange(size, dtype=mask.dtype) - (size - 1) / 2
    bell = torch.exp(-0.5 * (x / sigma) ** 2)
    kernel = torch.outer(bell, bell) / bell.sum() ** 2
    padded = functional.pad(mask[None], (size // 2,) * 4, mode="reflect")
    return functional.conv2d(padded, kernel[None, None])[0]


def region_ratio(ratio: Tensor, region: Tensor) -> Tensor:
    """ZeroComp's form: the ratio inside the masked region, 1 outside, softly between."""
    soft = gaussian_blur(region)
    return soft * ratio + (1.0 - soft)


def colour_balance(background: Tensor, no_shadow: Tensor, mask: Tensor) -> Tensor:
    """k: the background's mean colour outside the mask ÷ the prediction's, one a channel."""
    outside = 1.0 - mask
    numerator = (outside * background).sum(dim=(1, 2), keepdim=True)
    return numerator / (outside * no_shadow).sum(dim=(1, 2), keepdim=True)


def composited(
    predicted: Tensor,
    no_shadow: Tensor,
    background: Tensor,
    m_obj: Tensor,
    region: Tensor | None = None,
) -> Tensor:
    """out = k·pred·mask + background·(1−mask)·ratio; with a region, in ZeroComp's form."""
    mask = square_dilation(m_obj)
    ratio = shadow_ratio(predicted, no_shadow)
    if region is not None:
        ratio = region_ratio(ratio, region)
    k = colour_balance(background, no_shadow, mask)
    return k * predicted * mask + background * (1.0 - mask) * ratio


def linear_light(encoded: Tensor) -> Tensor:
    """Linear light of gamma 2.2 pixels."""
    return encoded.clamp(0.0, 1.0) ** 2.2


def linear_of_srgb(encoded: Tensor) -> Tensor:
    """Linear light of sRGB pixels (IEC 61966-2-1)."""
    x = encoded.clamp(0.0, 1.0)
    return torch.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def displayed(encoded: Tensor) -> Tensor:
    """Gamma 2.2 pixels as sRGB ones (IEC 61966-2-1), both in [0, 1]."""
    linear = linear_light(encoded)
    curve = 1.055 * linear ** (1.0 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curve)
