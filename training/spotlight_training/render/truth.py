"""The true picture of a photograph into which the object is put under another light.

A user-controlled relight keeps the photograph, which its own dominant light lit, and lights only
the object, whose shadow darkens the photograph. No single lighting of the scene looks like that, so
the truth is composed of rendered parts. (The published test set has none for its eight azimuths.)
"""

from __future__ import annotations

import cv2
import numpy as np

from .mesh import Array
from .record import SceneRecord

DARKEST = 1e-6
"""Radiance below which a surface cannot be said to be in shadow."""


def relit_truth(record: SceneRecord, light: str, photograph: Array, exposure: float) -> Array:
    """Compose the truth of one light: linear and exposed, float32, shape (H, W, 3).

    With W and B the radiances with and without the object under that light and the scene's ambient
    light, the shadow leaves ``ratio = clip(W ÷ B, 0, 1)`` of the photograph, a channel at a time,
    and the truth is ``object + (1 − alpha) · ratio · photograph``. The object's own light,
    premultiplied, is what remains of W without the background it shows:
    ``W − (1 − alpha) · ratio · B``. So the truth is W where alpha is 1 and the darkened photograph
    where it is 0. On the soft edge between, where W holds both, the ratio is its neighbours'.

    Parameters
    ----------
    record : SceneRecord
    light : str
        Dominant light of the object.
    photograph : array, shape (H, W, 3)
        The background alone under its own lights, exposed; linear.
    exposure : float
        The photograph's exposure, applied to the object too.
    """
    alpha = record.object.alpha[..., None]
    seen = record.radiance({light: 1.0})
    behind = record.radiance({light: 1.0}, with_object=False)
    ratio = np.where(behind > DARKEST, seen / np.maximum(behind, DARKEST), 1.0)
    ratio = _carried_on(np.clip(ratio, 0.0, 1.0).astype(np.float32), record.object.alpha)
    own = np.where(alpha > 0, np.maximum(seen - (1 - alpha) * ratio * behind, 0.0), 0.0)
    return (own * exposure + (1 - alpha) * ratio * photograph).astype(np.float32)


def _carried_on(ratio: Array, alpha: Array) -> Array:
    """Where the object shows, the mean of those of the eight neighbours where it does not.

    A wider neighbourhood would bring light under contact shadows, which are as narrow.
    """
    free = (alpha == 0).astype(np.float32)
    total = cv2.boxFilter(ratio * free[..., None], -1, (3, 3), normalize=False)
    count = cv2.boxFilter(free, -1, (3, 3), normalize=False)[..., None]
    near = np.divide(total, count, out=np.ones_like(total), where=count > 0.5)
    return np.where(free[..., None] > 0, ratio, near)
