"""The object's light at full resolution, from the object's light at the model's scale.

Lambert's law makes it linear in the albedo and in the albedo times the normal, and a highlight adds
to it what the albedo does not know of. These three are fitted around each small pixel and
evaluated on the large maps: texture and relief are the maps' own, shading is the renderer's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.upsampling import (
    FIT_SIGMA,
    GuidedFit,
    cell_of,
    fit_guided,
    grid_of,
)
from spotlight_runtime.relighting.canvas import Canvas

__all__ = ["ObjectLight", "divided", "fit_light", "light_rows"]


DARK: Final = 0.1
"""Albedo below which what a fit leaves over is rather a highlight than a shadow."""
SLOPE_RIDGE: Final = 0.03
"""Keeps slopes small where normals hardly vary; of the albedo's mean square, so that dark objects
have as much relief as bright ones. A larger one flattens what the renderer says of light: of 120
pictures by the mini 72 % showed the light they were asked for within 45° at 0.1, 77 % at 0.03 and
0.01; against 0.1 these two lose 0.05 and 0.17 dB."""
LEAST: Final = 0.3
"""Share of the object's mean light that reaches all of it, where light is smooth. No room leaves
black what turns away from the lamp, but guidance does, and slopes go on from there. Of 128 pictures
by the mini the object is 0.5 dB nearer to the truth than with none, its contrast is the truth's
(0.57 for 0.60), and following the same; more takes contrast away."""
HIGHLIGHT_RIDGE: Final = 0.3
"""Leaves to a highlight only what albedo cannot explain; 0.3 does best between 0.01 and 1."""
DECODED_BLUR: Final = 0.45
"""Deviation in pixels of the blur that decoding leaves in a prediction. The maps it is fitted to
are blurred alike, or the fit would take dulled texture for a highlight. 0.3 to 0.5 serve sharp and
soft decoders; on path-traced truths shrunk four times, blurred by 0.7 and brought back the object
has 28.7 dB where bicubic enlargement has 25.0, and 30.7 where 27.9 if they are not blurred."""
THINNEST: Final = 0.25
"""Coverage below which a small pixel says nothing about the object."""
BARELY_COVERED: Final = 1e-4
MARGIN: Final = 8
"""Pixels beyond the object that a fit takes in: more than any blur of its edge."""

Box = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class ObjectLight:
    """One channel of the object's light.

    Attributes
    ----------
    fit : GuidedFit
        Of use where the object is.
    least : float
        Times the albedo, the light that is everywhere on it.
    """

    fit: GuidedFit
    least: float


def fit_light(small: Canvas, own: FloatArray, reach: float = 0.0) -> tuple[ObjectLight, ...]:
    """Fit the object's own light to its albedo and normals.

    What the fit leaves over is the object's own shadows and highlights, if the pixels it was
    fitted to can be believed one by one. Where they cannot (`BackboneSpec.light_reach`), it is the
    decoder's noise, and left out.

    Parameters
    ----------
    small : Canvas
        At the model's scale.
    own : ndarray of float32, shape (h, w, 3)
        Light from the object alone: linear, premultiplied by its mask.
    reach : float
        Small pixels over which light is smooth; 0: as fine as a fit can tell.

    Returns
    -------
    tuple of ObjectLight
        One a channel.
    """
    reach, smooth = reach or FIT_SIGMA, reach > 0.0
    cell = cell_of(reach, smooth)
    about, cells = _about_object(small.mask, cell)
    mask = small.mask[about]
    light = own[about] / np.maximum(mask, np.float32(THINNEST))[..., None]
    albedo = np.clip(divided(small.albedo[about], mask), 0.0, 1.0)
    normal = divided(small.normal[about], mask)
    counted = np.where(mask >= THINNEST, mask * mask, np.float32(0.0))
    fits = []
    for value, colour in zip(np.moveaxis(light, 2, 0), np.moveaxis(albedo, 2, 0)):
        blurred = _blurred(_light_guide(colour * mask, normal), mask)
        slopes, energy = normal.shape[2], float((counted * colour**2).sum())
        shading = float((counted * colour * value).sum()) / energy if energy > 0.0 else 1.0
        slope = SLOPE_RIDGE * energy / max(float(counted.sum()), BARELY_COVERED)
        fit = fit_guided(
            value,
            counted,
            blurred,
            ridge=(*[slope] * slopes, 0.0, HIGHLIGHT_RIDGE),
            usual=(*[0.0] * slopes, shading, 0.0),
            leftover=None if smooth else _leftover(colour, slopes),
            reach=reach,
            smooth=smooth,
        )
        coefficients = np.zeros((*grid_of(small.size, cell), slopes + 2), dtype=np.float32)
        coefficients[cells] = fit.coefficients
        fits.append(ObjectLight(GuidedFit(coefficients), LEAST * shading if smooth else 0.0))
    return tuple(fits)


def _about_object(mask: FloatArray, cell: float) -> tuple[Box, Box]:
    """The object's box and a margin where nothing counts, in pixels and in cells of a fit.

    All of the picture where it is not divided into cells of whole pixels.
    """
    step, grid = int(cell), grid_of(mask.shape, cell)
    covered = mask > 0.0
    if (grid[0] * cell, grid[1] * cell) != mask.shape or not covered.any():
        return np.s_[:, :], np.s_[:, :]
    margin = -(-MARGIN // step)
    cells = []
    for axis, count in enumerate(grid):
        place = np.flatnonzero(covered.any(axis=1 - axis)) // step
        first, last = int(place[0]) - margin, int(place[-1]) + 1 + margin
        cells.append(slice(max(first, 0), min(last, count)))
    rows, columns = (slice(part.start * step, part.stop * step) for part in cells)
    return (rows, columns), (cells[0], cells[1])


def _leftover(colour: FloatArray, slopes: int) -> FloatArray:
    """How what a fit leaves over is shared: to the highlight where the albedo is dark."""
    shares = np.zeros((*colour.shape, slopes + 2), dtype=np.float32)
    shares[..., -2] = colour / (colour**2 + DARK**2)
    shares[..., -1] = DARK**2 / (colour**2 + DARK**2)
    return shares


def light_rows(
    lights: Sequence[ObjectLight],
    albedo: FloatArray,
    normal: FloatArray,
    mask: FloatArray,
    top: int,
    bottom: int,
    size: tuple[int, int],
    columns: slice = slice(None),
) -> FloatArray:
    """Rows [top, bottom) of the object's light at full resolution.

    Parameters
    ----------
    lights : sequence of ObjectLight
        As `fit_light` returns them.
    albedo : ndarray of float32, shape (bottom − top, W, 3)
    normal : ndarray of float32, shape (bottom − top, W, 3 or 0)
    mask : ndarray of float32, shape (bottom − top, W)
        Of these rows; the others premultiplied by it.
    top, bottom : int
    size : tuple of int
        Height and width of the large picture.
    columns : slice
        The W columns of it that the maps are of; by default all.

    Returns
    -------
    ndarray of float32, shape (bottom − top, W, 3)
        Linear, premultiplied.
    """
    normal = divided(normal, mask)
    light = np.empty(albedo.shape, dtype=np.float32)
    for channel, each in enumerate(lights):
        colour = albedo[..., channel]
        guide = _light_guide(colour, normal)
        rows = each.fit.rows(guide, top, bottom, size, mask, columns)
        np.maximum(rows, np.float32(each.least) * colour, out=light[..., channel])
    return light


def divided(premultiplied: FloatArray, cover: FloatArray) -> FloatArray:
    """Undo premultiplication; 0 where nothing is covered."""
    cover = cover if premultiplied.ndim == 2 else cover[..., None]
    cover = np.broadcast_to(cover, premultiplied.shape)
    return np.divide(
        premultiplied, cover, out=np.zeros_like(premultiplied), where=cover > BARELY_COVERED
    )


def _blurred(premultiplied: FloatArray, mask: FloatArray) -> FloatArray:
    """Blur as a decoder does, by coverage."""
    border = cv2.BORDER_REPLICATE
    planes, cover = (
        cv2.GaussianBlur(array, (0, 0), DECODED_BLUR, borderType=border)
        for array in (premultiplied, mask)
    )
    return divided(planes.reshape(premultiplied.shape), cover)


def _light_guide(albedo: FloatArray, normal: FloatArray) -> FloatArray:
    """What light is linear in (Lambert): albedo times normal, and albedo; shape (h, w, 4 or 1)."""
    return np.concatenate([albedo[..., None] * normal, albedo[..., None]], axis=2)
