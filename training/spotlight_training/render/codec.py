"""How a record's arrays become PNG files: logarithmic radiance, millimetre depth, 8-bit maps."""

from __future__ import annotations

import cv2
import numpy as np

from .mesh import Array

GAMMA = 2.2
DARK = 1.0 / 512
BRIGHT = 64.0
LEVELS = 4095
DEPTH_STEP = 0.0005
"""Metres a depth step; 16 bits reach 32 m."""


def encode_radiance(radiance: Array) -> Array:
    """Encode linear radiance in [0, 64] as uint16 codes in [0, 4095].

    A step is 0.34 % of the value, 7e-6 near black.
    """
    scaled = np.log1p(np.clip(radiance, 0.0, BRIGHT) / DARK) / np.log1p(BRIGHT / DARK)
    return np.round(scaled * LEVELS).astype(np.uint16)


_RADIANCE = (np.expm1(np.arange(LEVELS + 1) / LEVELS * np.log1p(BRIGHT / DARK)) * DARK).astype(
    np.float32
)


def decode_radiance(codes: Array) -> Array:
    """Return float32 linear radiance."""
    return _RADIANCE[codes]


def encode_depth(depth: Array) -> Array:
    """Encode metres in [0, 32.7] as uint16."""
    return np.round(np.clip(depth / DEPTH_STEP, 0, 65535)).astype(np.uint16)


def decode_depth(codes: Array) -> Array:
    """Return float32 metres."""
    return codes.astype(np.float32) * np.float32(DEPTH_STEP)


def encode_unit(values: Array) -> Array:
    """Encode [0, 1] as uint8."""
    return np.round(np.clip(values, 0.0, 1.0) * 255).astype(np.uint8)


def decode_unit(codes: Array) -> Array:
    """Return float32 in [0, 1]."""
    return codes.astype(np.float32) / np.float32(255)


def encode_albedo(albedo: Array) -> Array:
    """Encode linear albedo in [0, 1] as gamma-2.2 uint8, which keeps dark colours apart."""
    return encode_unit(np.clip(albedo, 0.0, 1.0) ** (1 / GAMMA))


def decode_albedo(codes: Array) -> Array:
    """Return float32 linear albedo."""
    return decode_unit(codes) ** np.float32(GAMMA)


def encode_normal(normal: Array) -> Array:
    """Encode unit vectors as uint8, 0 at code 128 rounded down from 127.5."""
    return encode_unit(normal * 0.5 + 0.5)


def decode_normal(codes: Array) -> Array:
    """Return float32 vectors of unit length."""
    vector = decode_unit(codes) * 2 - 1
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), np.float32(1e-6))


def encode_image(linear: Array) -> Array:
    """Return the gamma-2.2 encoded image in [0, 1] of linear radiance.

    `clip(x, 0, 1) ** (1 / 2.2)`, float32.
    """
    return np.clip(linear, 0.0, 1.0).astype(np.float32) ** np.float32(1 / GAMMA)


def to_png(array: Array) -> bytes:
    """Compress a uint8 or uint16 array of 1 or 3 channels (RGB) as PNG."""
    ok, data = cv2.imencode(
        ".png", array if array.ndim == 2 else array[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 3]
    )
    if not ok:
        raise ValueError(
            f"png: cannot encode an array of shape {array.shape} and type {array.dtype}."
        )
    return bytes(data)


def from_png(data: bytes) -> Array:
    """Return what `to_png` was given."""
    array = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if array is None:
        raise ValueError(
            f"png: {len(data)} bytes that do not decode. The record is damaged; "
            "render its scene again."
        )
    return array if array.ndim == 2 else np.ascontiguousarray(array[..., ::-1])
