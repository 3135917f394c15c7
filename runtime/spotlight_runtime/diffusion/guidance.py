"""Shadow-contrast guidance of the object (paper §3.3, eq. 2)."""

from __future__ import annotations

from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray

__all__ = ["masked_guidance", "rescale_guidance"]

LEAST_DEVIATION: Final = 2.0**-20
"""Of a prediction's largest value: a deviation below it is float32 rounding, and to divide by it
would multiply the prediction by millions."""


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
    """Pull the guided prediction's deviation on the object back to the positive branch's.

    Lin et al. 2023, eq. 15–16, with both deviations taken over the object (mask > 0.5) only. An
    object too small to have one there, or a prediction that is constant but for rounding, leaves
    nothing to restore: the prediction is returned unchanged.

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
    inside = np.broadcast_to(mask > 0.5, guided.shape)
    if phi == 0.0 or not inside.any():
        return guided
    target, present = (float(v[inside].std(dtype=np.float64)) for v in (v_pos, guided))
    if target == 0.0 or present <= LEAST_DEVIATION * float(np.abs(guided[inside]).max()):
        return guided
    return guided * (1.0 + phi * (target / present - 1.0))
