"""Guidance between the two branches: eq. 2, and the rescale of Lin et al. 2023."""

from __future__ import annotations

from torch import Tensor


def masked_guidance(v_pos: Tensor, v_neg: Tensor, m: Tensor, gamma: float) -> Tensor:
    """Eq. 2: the positive branch outside the object, extrapolated away from the negative inside."""
    return (1.0 - m) * v_pos + m * (v_neg + gamma * (v_pos - v_neg))


def rescaled_guidance(v: Tensor, v_pos: Tensor, m: Tensor, phi: float) -> Tensor:
    """Lin et al. 2023, section 3.4, with both deviations taken over all channels of the object.

    Where there is no object, or no deviation to divide by, there is nothing to rescale.
    """
    inside = (m > 0.5).expand_as(v)
    if not inside.any():
        return v
    deviation, wanted = v[inside].std(correction=0), v_pos[inside].std(correction=0)
    if deviation == 0.0:
        return v
    return phi * (v * wanted / deviation) + (1.0 - phi) * v
