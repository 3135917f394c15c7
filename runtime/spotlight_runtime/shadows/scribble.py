"""Drawings as guiding shadows: any grey picture, cleaned."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import InvalidInputError, NonFiniteError, ShapeError
from spotlight_runtime.imaging.colour import luma

__all__ = ["check_shadow", "clean_scribble", "grey_of"]


_PAPER: Final = 20.0
"""Percentile of the drawing that counts as its untouched paper."""
_FAINTEST: Final = 0.02
"""Contrast below which there is no drawing."""
_GRAIN: Final = 0.06
"""Of the contrast: what compression and brushes leave on the paper."""
_WIDTH_OF_SIGMA: Final = 2.563
"""A Gaussian edge climbs from 10 to 90 % within so many standard deviations."""
_DARK: Final = 0.1
"""From here on a shadow hides the shading from the network."""
_INVERTED: Final = (
    "scribble: expected white where the shadow falls, on black; most of it is white. "
    "Invert it (--invert)"
)
_EMPTY: Final = f"scribble: expected a drawing, found nothing that stands out by {_FAINTEST:.0%}"


def clean_scribble(
    drawing: FloatArray,
    object_mask: FloatArray,
    *,
    softness: float = 0.0,
    invert: bool = False,
) -> FloatArray:
    """Make a guiding shadow of a drawing.

    The drawing is stretched to the picture, its paper becomes 0 and its strongest stroke 1, its
    edges are softened, and what lies under the object is cut away.

    Parameters
    ----------
    drawing : ndarray of float32, shape (h, w) or (h, w, C) with C from 1 to 4
        White is shadow, on black or on nothing (colours count by their luma, times alpha).
    object_mask : ndarray of float32, shape (H, W)
        In [0, 1].
    softness : float
        Pixels of the picture over which an edge climbs from 10 to 90 %.
    invert : bool
        The drawing has black shadow on white.

    Returns
    -------
    ndarray of float32, shape (H, W)
        In [0, 1]; 0 under the object.

    Raises
    ------
    ShapeError, NonFiniteError
        If the drawing is no picture.
    InvalidInputError
        If nothing is drawn, nothing but the object is drawn on, or it seems to be inverted.
    """
    if not (math.isfinite(softness) and softness >= 0.0):
        raise InvalidInputError(f"softness: expected pixels ≥ 0, got {softness}")
    height, width = object_mask.shape
    grey = grey_of(drawing, invert=invert)
    shrinks = grey.shape[0] > height or grey.shape[1] > width
    grey = np.asarray(
        cv2.resize(
            np.ascontiguousarray(grey, dtype=np.float32),
            (width, height),
            interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR,
        )
    )
    paper, ink = float(np.percentile(grey, _PAPER)), float(grey.max())
    if float(np.median(grey)) - paper > 0.5 * (ink - paper) or paper > 0.5:
        raise InvalidInputError(_INVERTED)
    if ink - paper < _FAINTEST:
        raise InvalidInputError(_EMPTY)
    shadow = np.clip((grey - paper) / (ink - paper), 0.0, 1.0)
    shadow = np.clip((shadow - _GRAIN) / (1.0 - _GRAIN), 0.0, 1.0)
    if softness > 0.0:
        # The edge of the picture goes on beyond it, so a stroke that leaves it stays dark there.
        border = cv2.BORDER_REPLICATE
        shadow = cv2.GaussianBlur(shadow, (0, 0), softness / _WIDTH_OF_SIGMA, borderType=border)
    cleaned = np.asarray(shadow, dtype=np.float32) * np.clip(1.0 - object_mask, 0.0, 1.0)
    if not (cleaned > _DARK).any():
        raise InvalidInputError(
            "scribble: expected a shadow beside the object, but it lies under the object alone; "
            "draw where the background is seen"
        )
    return cleaned


def check_shadow(shadow: FloatArray, *, blank: bool = False) -> None:
    """Raise what `clean_scribble` would say of a shadow that is taken as it is.

    Parameters
    ----------
    shadow : ndarray of float32, shape (H, W)
        In [0, 1].
    blank : bool
        It may be empty.

    Raises
    ------
    InvalidInputError
        If it is empty, or 1 nearly everywhere.
    """
    if float(np.percentile(shadow, _PAPER)) > 1.0 - _DARK:
        raise InvalidInputError(_INVERTED)
    if not blank and float(shadow.max()) < _FAINTEST:
        raise InvalidInputError(_EMPTY)


def grey_of(drawing: FloatArray, *, invert: bool = False) -> FloatArray:
    """Luma times alpha: what is drawn on nothing counts by how much it covers.

    Parameters
    ----------
    drawing : ndarray of float32, shape (h, w) or (h, w, C) with C from 1 to 4
    invert : bool
        Black counts instead of white.

    Returns
    -------
    ndarray of float32, shape (h, w)
        In [0, 1] if alpha is.

    Raises
    ------
    ShapeError, NonFiniteError
    """
    if not 2 <= drawing.ndim <= 3 or drawing.size == 0:
        raise ShapeError(f"scribble: expected shape (h, w) or (h, w, 1..4), got {drawing.shape}")
    if not np.isfinite(drawing).all():
        raise NonFiniteError("scribble: it holds NaN or infinity; grey is from 0 to 1")
    planes = drawing[..., None] if drawing.ndim == 2 else drawing
    channels = planes.shape[2]
    if channels > 4:
        raise ShapeError(f"scribble: expected at most 4 channels, got {channels}")
    grey = luma(planes[..., :3]) if channels >= 3 else planes[..., 0]
    grey = np.clip(1.0 - grey if invert else grey, 0.0, 1.0)
    return np.asarray(grey * planes[..., -1] if channels in (2, 4) else grey)
