"""Light from one direction on a surface, in polynomials of its normal."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

__all__ = ["HARMONICS", "harmonics", "lambertian"]

HARMONICS: Final = 9
"""Up to the second order: 1, x, y, z, xy, yz, xz, 3z² − 1, x² − y²."""

CLAMPED_COSINE: Final = (0.25, *3 * (0.5,), *3 * (15 / 16,), 5 / 64, 15 / 64)
"""Of max(0, n·d) in products of these polynomials of n and of d: the first orders of the Funk-Hecke
theorem (Ramamoorthi & Hanrahan 2001, eq. 7 and 8). They are within 0.1 of it."""


def harmonics(normal: Tensor) -> Tensor:
    """Polynomials (B, `HARMONICS`, …) of unit vectors (B, 3, …)."""
    x, y, z = normal.unbind(dim=1)
    ones = torch.ones_like(x)
    return torch.stack([ones, x, y, z, x * y, y * z, x * z, 3 * z * z - 1, x * x - y * y], dim=1)


def lambertian(towards: Tensor) -> Tensor:
    """Weights (B, `HARMONICS`, …) of `harmonics` that are light from ``towards`` (B, 3, …)."""
    weights = harmonics(towards)
    scale = weights.new_tensor(CLAMPED_COSINE).reshape(-1, *[1] * (weights.dim() - 2))
    return scale * weights
