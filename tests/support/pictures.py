"""Picture files with what cameras write into them."""

from __future__ import annotations

import struct

import cv2
import numpy as np


def exif(orientation: int, focal_35mm: int | None = None, order: str = "<") -> bytes:
    """An EXIF block with an orientation and a 35 mm focal length."""
    start = b"II*\0" if order == "<" else b"MM\0*"
    main = [(0x0112, 3, orientation), (0x8769, 4, 8 + 2 + 2 * 12 + 4)]
    extra = [] if focal_35mm is None else [(0xA405, 3, focal_35mm)]
    block = start + struct.pack(order + "I", 8)
    for fields in (main, extra):
        block += struct.pack(order + "H", len(fields))
        for tag, kind, value in fields:
            packed = struct.pack(
                order + ("HH" if kind == 3 else "I"), *([value, 0] if kind == 3 else [value])
            )
            block += struct.pack(order + "HHI", tag, kind, 1) + packed
        block += struct.pack(order + "I", 0)
    return block


def jpeg_with_exif(pixels: np.ndarray, block: bytes) -> bytes:
    """A JPEG (of BGR pixels) with an EXIF block."""
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    body = b"Exif\0\0" + block
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
