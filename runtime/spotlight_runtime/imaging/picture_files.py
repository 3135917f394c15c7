"""Finished pictures as files: each format holds the light that it is known to hold."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import srgb_to_linear
from spotlight_runtime.imaging.images import write_image

__all__ = ["LINEAR_SUFFIXES", "write_picture"]


LINEAR_SUFFIXES: Final = {".exr", ".hdr"}
"""Formats whose numbers are linear light, as every program that reads them takes for granted."""


def write_picture(
    path: str | Path, picture: FloatArray, *, bits: int = 8, quality: int = 95
) -> None:
    """Write a picture for people to look at: OpenEXR and Radiance HDR as linear light, else sRGB.

    `write_image` stores values as they are, which is right for maps and shadows.

    Parameters
    ----------
    path : str or Path
        ``.png``, ``.jpg``/``.jpeg``, ``.webp``, ``.hdr`` or ``.exr``.
    picture : ndarray of float32 or float16, shape (H, W, 3)
        sRGB-encoded, in [0, 1] (clipped), as `RelightResult.image` is. An OpenEXR file of float16
        holds halves.
    bits, quality : int
        See `write_image`.

    Raises
    ------
    InvalidInputError, DtypeError
        If the format cannot hold the picture.
    ImageFileError
        If the file cannot be written.
    """
    if Path(path).suffix.lower() in LINEAR_SUFFIXES:
        picture = srgb_to_linear(picture.astype(np.float32)).astype(picture.dtype)
    write_image(path, picture, bits=bits, quality=quality)
