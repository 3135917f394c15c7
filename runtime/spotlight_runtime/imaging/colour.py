"""Transfer curves between linear light and encoded pixels, named for what they do.

Three encodings occur: ``linear`` radiance (EXR, HDR, albedo), ``srgb`` (IEC 61966-2-1: photographs,
PNG, JPEG, results) and ``gamma22`` (``clip(x, 0, 1)^(1/2.2)``, what diffusion renderers are
trained on). None of these functions clips silently unless its docstring says so.
"""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray

__all__ = [
    "Encoding",
    "decode_to_linear",
    "encode_linear",
    "gamma22_to_linear",
    "linear_to_gamma22",
    "linear_to_srgb",
    "luma",
    "srgb_to_linear",
    "stored_to_linear",
]

Encoding = Literal["linear", "srgb", "gamma22"]


def linear_to_gamma22(linear: FloatArray) -> FloatArray:
    """``clip(x, 0, 1)^(1/2.2)``: linear radiance to the encoding renderers are trained on."""
    return np.power(np.clip(linear, 0.0, 1.0), np.float32(1 / 2.2))


def gamma22_to_linear(encoded: FloatArray) -> FloatArray:
    """``x^2.2`` of pixels in [0, 1] (clipped)."""
    return np.power(np.clip(encoded, 0.0, 1.0), np.float32(2.2))


def linear_to_srgb(linear: FloatArray) -> FloatArray:
    """Linear light to sRGB pixels, both in [0, 1] (clipped)."""
    x = np.clip(linear, 0.0, 1.0)
    curve = np.float32(1.055) * np.power(x, np.float32(1 / 2.4)) - np.float32(0.055)
    return np.where(x <= 0.0031308, np.float32(12.92) * x, curve)


def srgb_to_linear(encoded: FloatArray) -> FloatArray:
    """Convert sRGB pixels to linear light, both in [0, 1] (clipped)."""
    x = np.clip(encoded, 0.0, 1.0)
    curve = np.power((x + np.float32(0.055)) / np.float32(1.055), np.float32(2.4))
    return np.where(x <= 0.04045, x / np.float32(12.92), curve)


def encode_linear(linear: FloatArray, encoding: Encoding) -> FloatArray:
    """Apply the named transfer curve; ``linear`` leaves values as they are."""
    if encoding == "linear":
        return linear
    return linear_to_srgb(linear) if encoding == "srgb" else linear_to_gamma22(linear)


def decode_to_linear(pixels: FloatArray, encoding: Encoding) -> FloatArray:
    """Undo the named transfer curve; ``linear`` leaves values as they are."""
    if encoding == "linear":
        return pixels
    return srgb_to_linear(pixels) if encoding == "srgb" else gamma22_to_linear(pixels)


def stored_to_linear(pixels: npt.NDArray[Any], encoding: Encoding) -> FloatArray:
    """Linear light of pixels as a file stores them.

    Parameters
    ----------
    pixels : ndarray of uint8, uint16 or float
        Integers are fractions of their type's largest value.
    encoding : {"linear", "srgb", "gamma22"}

    Returns
    -------
    ndarray of float32, same shape
        The same numbers as `decode_to_linear`, by a table where pixels are integers: without the
        temporaries that make gigabytes of a large photograph.
    """
    if not np.issubdtype(pixels.dtype, np.integer):
        return decode_to_linear(pixels.astype(np.float32), encoding)
    top = np.iinfo(pixels.dtype).max
    levels = np.arange(top + 1).astype(np.float32) / np.float32(top)
    table = decode_to_linear(levels, encoding)
    if pixels.dtype == np.uint8:
        return np.asarray(cv2.LUT(pixels, table))
    linear = np.empty(pixels.shape, dtype=np.float32)
    for row, values in enumerate(pixels):
        linear[row] = table[values]
    return linear


def luma(encoded: FloatArray) -> FloatArray:
    """Intensity I = 0.299 R + 0.587 G + 0.114 B of encoded pixels.

    Parameters
    ----------
    encoded : ndarray of float32, shape (H, W, 3)

    Returns
    -------
    ndarray of float32, shape (H, W)
    """
    return encoded @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
