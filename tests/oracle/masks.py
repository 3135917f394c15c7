"""Resampling, morphology, and the two masks that live on the latent grid."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

BINARY_THRESHOLD = 0.05
EDGE_BOOST = 2.0


def bilinear(mask: Tensor, size: tuple[int, int], *, antialias: bool) -> Tensor:
    """A (1, H, W) map resampled bilinearly onto a grid of `size`."""
    return functional.interpolate(
        mask[None], size=size, mode="bilinear", align_corners=False, antialias=antialias
    )[0]


def cross_dilation(mask: Tensor) -> Tensor:
    """The largest of a pixel and its four neighbours; what lies outside the map does not count."""
    tall = functional.max_pool2d(mask[None], (3, 1), stride=1, padding=(1, 0))[0]
    wide = functional.max_pool2d(mask[None], (1, 3), stride=1, padding=(0, 1))[0]
    return torch.maximum(tall, wide)


def cross_erosion(mask: Tensor) -> Tensor:
    """The smallest of a pixel and its four neighbours."""
    return -cross_dilation(-mask)


def square_dilation(mask: Tensor) -> Tensor:
    """The largest value of the 3×3 neighbourhood: dilation by one pixel."""
    return functional.max_pool2d(mask[None], 3, stride=1, padding=1)[0]


def latent_shadow_mask(m_shw: Tensor, m_obj: Tensor, size: tuple[int, int]) -> Tensor:
    """m_shw,↓ of eq. 1: downsampled, binarised, edge widened and doubled, kept off the object."""
    shadow = (bilinear(m_shw, size, antialias=False) > BINARY_THRESHOLD).to(m_shw.dtype)
    inside = (bilinear(m_obj, size, antialias=False) > BINARY_THRESHOLD).to(m_obj.dtype)
    eroded = cross_erosion(shadow)
    edge = cross_dilation(shadow) - eroded
    return (eroded + EDGE_BOOST * edge) * (1.0 - inside)


def guidance_mask(m_obj: Tensor, size: tuple[int, int]) -> Tensor:
    """m_obj,↓ of eq. 2: downsampled with antialiasing, left soft."""
    return bilinear(m_obj, size, antialias=True)
