"""Guided upsampling: a small picture follows the edges of maps known at full resolution.

What is brought back from the model's scale is never pixels but how they depend on something the
photograph's scale knows: the shadow's ratio image on the guiding shadow; the object's light on its
albedo and normals, where Lambert's law is ``albedo · (a · normal + b)`` and a highlight adds a
constant. Around each small pixel these dependences are fitted by weighted least squares, and the
fit is evaluated on the large maps (He and Sun 2015, "Fast guided filter", with weights). What a fit
leaves over, shadows inside for one, is smoothed by the least that hides the small grid and added
back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray

__all__ = ["FIT_SIGMA", "GuidedFit", "cell_of", "fit_guided", "grid_of", "magnify_rows"]


FIT_SIGMA: Final = 1.2
"""Reach of a fit, in small pixels: the narrowest that determines five numbers at an edge."""
CELLS: Final = 2.0
"""Cells of the grid in a smooth fit's reach."""
LEFTOVER_SIGMA: Final = 0.6
"""Smoothing of what the fit leaves over, in small pixels."""
PRIOR: Final = 1e-6
"""Weight of what is usual in a fit: it decides where nothing is known, deep inside a hole."""


@dataclass(frozen=True, slots=True, eq=False)
class GuidedFit:
    """A small picture as local functions of its guide.

    Attributes
    ----------
    coefficients : ndarray of float32, shape (h, w, G + 1)
        Slope for each channel of the guide; last, the constant. On the small picture's pixels, or
        a grid of fewer.
    """

    coefficients: FloatArray

    def rows(
        self,
        guide: FloatArray,
        top: int,
        bottom: int,
        size: tuple[int, int],
        cover: FloatArray,
        columns: slice = slice(None),
    ) -> FloatArray:
        """Evaluate rows [top, bottom) of the large picture.

        Parameters
        ----------
        guide : ndarray of float32, shape (bottom − top, W, G)
            These rows of the large guide, premultiplied by ``cover``.
        top, bottom : int
        size : tuple of int
            Height and width of the large picture.
        cover : ndarray of float32, shape (bottom − top, W)
            What guide and result are premultiplied by; ones if by nothing.
        columns : slice
            The W columns of the large picture that guide and cover are of; by default all.

        Returns
        -------
        ndarray of float32, shape (bottom − top, W)
            Premultiplied.
        """
        large = magnify_rows(self.coefficients, top, bottom, size)[:, columns]
        total = large[..., -1] * cover
        for channel in range(guide.shape[2]):
            total += large[..., channel] * guide[..., channel]
        return total


def fit_guided(
    values: FloatArray,
    weights: FloatArray,
    guide: FloatArray,
    *,
    ridge: Sequence[float],
    usual: Sequence[float] | Sequence[FloatArray],
    leftover: FloatArray | None = None,
    reach: float = FIT_SIGMA,
    smooth: bool = False,
) -> GuidedFit:
    """Fit a small picture to its guide, locally.

    Parameters
    ----------
    values : ndarray of float32, shape (h, w)
    weights : ndarray of float32, shape (h, w)
        How much each value counts, ≥ 0; where it is 0, values come from around.
    guide : ndarray of float32, shape (h, w, G)
        The guide at the same size; G may be 0.
    ridge : sequence of G + 1 float
        Penalty on the square of each coefficient, the constant's last.
    usual : sequence of G + 1 float, or of ndarray of float32 of shape (h, w)
        Coefficients where nothing is known.
    leftover : ndarray of float32, shape (h, w, G + 1), optional
        How much of what the fit leaves over goes to each coefficient; times guide and one, they
        add up to one. By default all of it goes to the constant.
    reach : float
        Standard deviation, in small pixels, of the neighbourhood that decides.
    smooth : bool
        Leave out what the fit leaves over. Such a fit has no more detail than its reach, and is
        solved on a grid of that much.

    Returns
    -------
    GuidedFit
    """
    count = guide.shape[2] + 1
    basis = np.ones((*values.shape, count))
    basis[..., :-1] = guide
    weights = weights.astype(np.float64)
    prior = PRIOR * (float(weights.mean()) or 1.0)
    cell = cell_of(reach, smooth)
    grid = grid_of(values.shape, cell)

    def gathered(array: FloatArray) -> FloatArray:
        """Cells of an array; their neighbourhoods are not mixed yet."""
        if grid == array.shape:
            return array
        return np.asarray(cv2.resize(array, grid[::-1], interpolation=cv2.INTER_AREA))

    reach /= cell
    weight = gathered(weights)
    near = _spread(weight, reach) + prior
    products = np.empty((*grid, count, count))
    moments = np.empty((*grid, count))
    for i in range(count):
        weighted = weights * basis[..., i]
        for j in range(i, count):
            both = _spread(gathered(weighted * basis[..., j]), reach)
            products[..., i, j] = products[..., j, i] = both
        products[..., i, i] += ridge[i] * near + prior
        moments[..., i] = _spread(gathered(weighted * values), reach) + prior * usual[i]
    solved = np.linalg.solve(products, moments[..., None])[..., 0]
    for i in range(count):  # neighbouring fits agree on one by their weights
        solved[..., i] = (_spread(weight * solved[..., i], reach) + prior * usual[i]) / near
    if smooth:
        return GuidedFit(solved.astype(np.float32))
    left = weights * (values - np.einsum("hwi,hwi->hw", solved, basis))
    close = _spread(weights, LEFTOVER_SIGMA) + prior
    if leftover is None:
        solved[..., -1] += _spread(left, LEFTOVER_SIGMA) / close
    else:
        for i in range(count):
            solved[..., i] += _spread(left * leftover[..., i], LEFTOVER_SIGMA) / close
    return GuidedFit(solved.astype(np.float32))


def cell_of(reach: float, smooth: bool) -> float:
    """Side of a fit's cells in small pixels."""
    return max(1.0, reach / CELLS) if smooth else 1.0


def grid_of(size: tuple[int, ...], cell: float) -> tuple[int, int]:
    """Rows and columns of cells for a small picture of this height and width."""
    rows, columns = (max(1, round(side / cell)) for side in size)
    return rows, columns


def magnify_rows(small: FloatArray, top: int, bottom: int, size: tuple[int, int]) -> FloatArray:
    """Rows [top, bottom) of a bilinear magnification, without making the others.

    Parameters
    ----------
    small : ndarray of float32, shape (h, w, C) or (h, w)
    top, bottom : int
        Rows of the large picture.
    size : tuple of int
        Height and width of the large picture.

    Returns
    -------
    ndarray of float32, shape (bottom − top, W, C) or (bottom − top, W)
        Pixel centres lie at +0.5; beyond the outermost ones the border is repeated.
    """
    height, width = size
    place = (np.arange(top, bottom) + 0.5) * (len(small) / height) - 0.5
    place = np.clip(place, 0.0, len(small) - 1.0)
    above = np.minimum(place.astype(np.intp), max(len(small) - 2, 0))
    below = np.minimum(above + 1, len(small) - 1)
    share = (place - above).astype(np.float32).reshape(-1, *[1] * (small.ndim - 1))
    rows = small[above] + share * (small[below] - small[above])
    if rows.shape[1] == width:
        return rows
    wide = cv2.resize(rows, (width, bottom - top), interpolation=cv2.INTER_LINEAR)
    return np.asarray(wide, dtype=np.float32)


def _spread(array: FloatArray, sigma: float) -> FloatArray:
    return cv2.GaussianBlur(array, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
