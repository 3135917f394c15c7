"""Reads and writes OpenEXR files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR

from .mesh import Array


def read_rgb(path: Path) -> Array:
    """Read an image's red, green and blue as float32, shape (H, W, 3).

    Raises
    ------
    ValueError
        If the file has no R, G and B channels.
    """
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        missing = [name for name in "RGB" if name not in channels]
        if missing:
            raise ValueError(
                f"image: expected channels R, G, B in {path}, found {', '.join(channels)}."
            )
        return np.stack([channels[name].pixels for name in "RGB"], axis=-1).astype(np.float32)


def write(path: Path, channels: Mapping[str, Array]) -> None:
    """Write named channels, each of shape (H, W), as ZIP-compressed scan lines.

    The arrays' dtype is kept.
    """
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    arrays = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    with OpenEXR.File(header, arrays) as file:
        file.write(str(path))
