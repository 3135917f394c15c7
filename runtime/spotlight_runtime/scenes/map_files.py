"""The image files of a scene bundle: whole maps, parts of maps, and maps that are enlarged.

An object's maps are empty outside it and a background's normals and depth are no finer than the
network that estimated them, so of a large photograph neither is stored pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import ShapeError
from spotlight_runtime.imaging import headers
from spotlight_runtime.imaging.colour import linear_to_srgb, stored_to_linear
from spotlight_runtime.imaging.decoding import decode_pixels, read_bytes
from spotlight_runtime.imaging.images import read_image, write_image, write_jpeg
from spotlight_runtime.parallel import in_parallel

__all__ = ["MapFile", "covered_box", "read_map_file", "write_map", "write_part", "write_reduced"]


WORTH_CROPPING: Final = 1 << 20
"""Pixels of a scene from which a map's empty surroundings are left out of its file."""
STRIP_ROWS: Final = 128

Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class MapFile:
    """One image file of a bundle.

    Attributes
    ----------
    file : str
        Path relative to the bundle, inside it.
    encoding : {"linear", "srgb", "gamma22", "normal"}
        Transfer curve of the pixels; ``normal`` is 0.5 + 0.5·n.
    scale : float
        Multiplies the decoded values (for depth in a 16-bit PNG: units per full scale).
    corner : (x, y), optional
        The file is a part of the map, and this is where its upper left pixel lies; the rest is 0.
    enlarged : bool
        The file is smaller than the scene, and the map is its bilinear enlargement.
    """

    file: str
    encoding: Literal["linear", "srgb", "gamma22", "normal"] = "linear"
    scale: float = 1.0
    corner: tuple[int, int] | None = None
    enlarged: bool = False


def read_map_file(path: Path, entry: MapFile, channels: int, size: tuple[int, int]) -> FloatArray:
    """Read a map at the scene's size.

    Parameters
    ----------
    path : Path
        Where the entry's file lies.
    entry : MapFile
    channels : {1, 3}
    size : tuple of int
        Height and width of the scene.

    Raises
    ------
    ImageFileError
        If it cannot be read.
    ShapeError
        If its size is not what the scene says, or it has too few channels.
    """
    decoded = _decode(path, entry, channels)
    height, width = decoded.shape[:2]
    if (entry.corner is not None or entry.enlarged) and size[0] * size[1] > headers.MAX_PIXELS:
        raise ShapeError(
            f"{path}: expected a scene of at most {headers.MAX_PIXELS // 1_000_000} megapixels to "
            f"make this map as large as, scene.json says {size[1]}×{size[0]}; correct its size"
        )
    if entry.corner is not None:
        x, y = entry.corner
        if not (0 <= x <= size[1] - width and 0 <= y <= size[0] - height):
            raise ShapeError(
                f"{path}: expected a part of the scene's {size[1]}×{size[0]} pixels, got "
                f"{width}×{height} at {x},{y}; compose or save the scene again"
            )
        # Zeros that nobody wrote take no memory.
        whole: FloatArray = np.zeros((*size, *decoded.shape[2:]), dtype=np.float32)
        whole[y : y + height, x : x + width] = decoded
        return whole
    if entry.enlarged and (height, width) != size and height <= size[0] and width <= size[1]:
        large = cv2.resize(decoded, (size[1], size[0]), interpolation=cv2.INTER_LINEAR)
        return np.asarray(large, dtype=np.float32)
    if (height, width) != size:
        raise ShapeError(
            f"{path}: expected {size[1]}×{size[0]} pixels as scene.json says, got {width}×{height}"
        )
    return decoded


def write_map(folder: Path, name: str, value: FloatArray) -> MapFile:
    """Write a whole map: PNG in 16 bits, EXR in float32."""
    write_image(folder / name, value, bits=16)
    return MapFile(name)


def write_part(folder: Path, name: str, value: FloatArray, box: Box) -> MapFile:
    """Write what a box of a map holds; all of it where little is left out.

    Parameters
    ----------
    value : ndarray of float32, shape (H, W) or (H, W, 3)
        0 outside the box.
    box : (top, bottom, left, right)
    """
    top, bottom, left, right = box
    height, width = value.shape[:2]
    small = height * width < WORTH_CROPPING
    if small or 2 * (bottom - top) * (right - left) > height * width or top >= bottom:
        return write_map(folder, name, value)
    write_image(folder / name, np.ascontiguousarray(value[top:bottom, left:right]), bits=16)
    return MapFile(name, corner=(left, top))


def write_reduced(folder: Path, name: str, value: FloatArray, side: int) -> MapFile:
    """Write a map shrunk to a longer side of at most so many pixels.

    A JPEG keeps its size, and is compressed instead: for albedo, whose texture counts.
    """
    if name.endswith(".jpg"):
        pixels = np.empty(value.shape, dtype=np.uint8)

        def fill(top: int) -> None:
            rows = np.s_[top : top + STRIP_ROWS]
            pixels[rows] = np.rint(linear_to_srgb(value[rows]) * np.float32(255.0))

        in_parallel(fill, range(0, len(value), STRIP_ROWS))
        write_jpeg(folder / name, pixels)
        return MapFile(name, encoding="srgb")
    height, width = value.shape[:2]
    factor = side / max(height, width)
    if factor >= 1.0:
        return write_map(folder, name, value)
    small = (max(1, round(width * factor)), max(1, round(height * factor)))
    shrunk = np.asarray(cv2.resize(value, small, interpolation=cv2.INTER_AREA))
    write_image(folder / name, shrunk, bits=16)
    return MapFile(name, enlarged=True)


def covered_box(mask: FloatArray) -> Box:
    """Rows [top, bottom) and columns [left, right) outside which a mask is 0."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return 0, 0, 0, 0
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def _decode(path: Path, entry: MapFile, channels: int) -> FloatArray:
    """Values of a file at its own size."""
    if path.suffix.lower() in (".exr", ".hdr"):
        pixels = read_image(path)
    else:
        pixels = decode_pixels(read_bytes(path), path)
    if channels == 1:
        pixels = pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[..., 0])
    elif pixels.ndim == 3 and pixels.shape[2] >= channels:
        pixels = np.ascontiguousarray(pixels[..., :channels])
    else:
        raise ShapeError(f"{path}: expected {channels} channels, got shape {pixels.shape}")
    with np.errstate(over="ignore", invalid="ignore"):  # the scene refuses what is not finite
        if entry.encoding == "normal":
            values = stored_to_linear(pixels, "linear")
            values *= np.float32(2.0)
            values -= np.float32(1.0)
        else:
            values = stored_to_linear(pixels, entry.encoding)
        return values if entry.scale == 1.0 else values * np.float32(entry.scale)
