"""Shadow-contrast guidance of the object (paper §3.3, eq. 2)."""

from __future__ import annotations

import numpy as np

from spotlight_runtime.arrays import FloatArray

__all__ = ["masked_guidance", "rescale_guidance"]


def masked_guidance(
    v_pos: FloatArray, v_neg: FloatArray, mask: FloatArray, gamma: float
) -> FloatArray:
    """Amplify, on the object, what the wanted shadow changes against the opposite one.

    Eq. 2, ``(1−m)·v_pos + m·(v_neg + γ(v_pos − v_neg))``, written as
    ``v_pos + m(γ−1)(v_pos − v_neg)``: the same in real arithmetic, and exactly ``v_pos`` at γ = 1
    whatever the negative branch holds.

    Parameters
    ----------
    v_pos, v_neg : ndarray of float32, shape (..., C, h, w)
        Predictions of the two branches.
    mask : ndarray of float32, shape (..., 1, h, w)
        Object mask at latent size, in [0, 1].
    gamma : float
        Guidance scale γ ≥ 0; 3 in the paper.

    Returns
    -------
    ndarray of float32, shape (..., C, h, w)
    """
    if gamma == 1.0:
        return v_pos
    return v_pos + (mask * (gamma - 1.0)) * (v_pos - v_neg)


def rescale_guidance(
    guided: FloatArray, v_pos: FloatArray, mask: FloatArray, phi: float
) -> FloatArray:
    """Pull the guided prediction's deviation inside the mask back to the positive branch's.

    Lin et al. 2023, eq. 15–16, restricted to the object: deviations are weighted by the mask. An
    empty mask or a constant prediction has no deviation to restore and is returned unchanged.

    Parameters
    ----------
    guided, v_pos : ndarray of float32, shape (1, C, h, w)
    mask : ndarray of float32, shape (1, 1, h, w)
        Object mask at latent size, in [0, 1].
    phi : float
        Strength φ in [0, 1]; 0 leaves ``guided`` untouched.

    Returns
    -------
    ndarray of float32, shape (1, C, h, w)
    """
    if phi == 0.0:
        return guided
    target, present = _masked_deviation(v_pos, mask), _masked_deviation(guided, mask)
    if target == 0.0 or present == 0.0:
        return guided
    return guided * (1.0 + mask * (phi * (target / present - 1.0)))


def _masked_deviation(v: FloatArray, mask: FloatArray) -> float:
    """Weighted standard deviation over all elements, in float64; 0 for an empty mask."""
    weight = np.broadcast_to(mask, v.shape).astype(np.float64)
    total = float(weight.sum())
    if total == 0.0:
        return 0.0
    mean = float((weight * v).sum()) / total
    return float(np.sqrt((weight * (v - mean) ** 2).sum() / total))
