"""The picture at the photograph's size, strip by strip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import linear_to_srgb
from spotlight_runtime.relighting.canvas import Canvas
from spotlight_runtime.relighting.layers import Layer
from spotlight_runtime.relighting.mixing import Mix
from spotlight_runtime.relighting.window import Window

__all__ = ["put_back"]


STRIP_PIXELS: Final = 1 << 19
"""Pixels worked on at a time: temporary arrays of a few megabytes."""


def put_back(canvas: Canvas, window: Window, layers: Sequence[Layer], mix: Mix) -> FloatArray:
    """The picture: the photograph, and in the window the layers' weighted sum.

    Parameters
    ----------
    canvas : Canvas
        The photograph.
    window : Window
    layers : sequence of Layer
        One a light.
    mix : Mix

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        sRGB-encoded, in [0, 1]; what no layer touches is the photograph's, bit for bit.
    """
    height, width = canvas.size
    image = np.empty((height, width, 3), dtype=np.float32)
    step = max(1, STRIP_PIXELS // width)
    for top in range(0, height, step):
        image[top : top + step] = linear_to_srgb(canvas.background[top : top + step])
    inside = window.crop(image)
    step = max(1, STRIP_PIXELS // window.width)
    for top in range(0, window.height, step):
        strip = inside[top : top + step]
        rows = [layer.rows(top, top + len(strip)) for layer in layers]
        untouched = np.logical_and.reduce([kept for _, kept in rows])
        lit = linear_to_srgb(mix.sum([linear for linear, _ in rows]))
        strip[:] = np.where(untouched[..., None], strip, lit)
    return image
