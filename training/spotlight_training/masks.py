"""Random masks that hide shading from the renderer while it learns (ZeroComp's manner).

Rectangles, circles, the object's own shape, or everything – never the outline of a shadow by
itself: SpotLight hides exactly that at inference, and stays training-free only if the renderer was
never taught what it means.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

__all__ = ["random_mask"]

BoolArray = npt.NDArray[np.bool_]
DROP_ALL = 0.05
OBJECT = 0.9
ABOUT_OBJECT = 0.9
WIDELY = 0.6
WIDEST = 0.35
NARROWEST = 0.05
FURTHER_SHAPES = (0, 0, 0, 1, 1, 2)


def random_mask(rng: np.random.Generator, object_mask: npt.NDArray[np.float32]) -> BoolArray:
    """Where shading is hidden.

    Parameters
    ----------
    rng : numpy.random.Generator
    object_mask : ndarray of float32, shape (H, W)
        Object coverage in [0, 1].

    Returns
    -------
    ndarray of bool, shape (H, W)
        One picture in twenty is hidden whole; nine in ten hide the object. Six in ten of these hide
        the floor about it too, by up to 35 % of the picture's height to all sides: shadows have to
        be found in noise there, as SpotLight's have to. The others grow it by up to 5 %, and most
        of them leave shadows in sight. On half of all come one or two rectangles or ellipses, most
        of these about the object, so that the hidden region has no telling outline.
    """
    height, width = object_mask.shape
    if rng.random() < DROP_ALL:
        return np.ones((height, width), dtype=bool)
    hidden = np.zeros((height, width), dtype=np.uint8)
    shapes = int(rng.choice(FURTHER_SHAPES))
    if rng.random() < OBJECT:
        hidden |= _grown(rng, object_mask)
    else:
        shapes = max(shapes, 1)
    rows, columns = np.nonzero(object_mask > 0.5)
    for _ in range(shapes):
        centre = rng.uniform(0.0, 1.0, 2) * (width, height)
        if rows.size and rng.random() < ABOUT_OBJECT:
            pixel = int(rng.integers(rows.size))
            centre = np.array([columns[pixel], rows[pixel]], dtype=float)
        _stamp(rng, hidden, centre.astype(int))
    return hidden.astype(bool)


def _grown(rng: np.random.Generator, object_mask: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """The object's pixels and those about it, as far to all sides."""
    covered = object_mask > 0.0
    share = WIDEST if rng.random() < WIDELY else NARROWEST
    reach = 1 + int(rng.uniform(0.0, share) * len(covered))
    if rng.random() < 0.5:
        square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        return cv2.dilate(covered.astype(np.uint8), square)
    if not covered.any():
        return covered.astype(np.uint8)
    away = cv2.distanceTransform((~covered).astype(np.uint8), cv2.DIST_L2, 3)
    return (away <= reach).astype(np.uint8)


def _stamp(
    rng: np.random.Generator, hidden: npt.NDArray[np.uint8], centre: npt.NDArray[np.int64]
) -> None:
    """Add a rectangle or ellipse of 5 to 60 % of each side about a pixel (x, y)."""
    height, width = hidden.shape
    half = (rng.uniform(0.05, 0.6, 2) * (width, height) / 2).astype(int) + 1
    if rng.random() < 0.5:
        low, high = centre - half, centre + half
        cv2.rectangle(hidden, low.tolist(), high.tolist(), 1, thickness=-1)
    else:
        angle = float(rng.uniform(0.0, 180.0))
        cv2.ellipse(hidden, centre.tolist(), half.tolist(), angle, 0.0, 360.0, 1, thickness=-1)
