"""Image files in and out: PNG 8/16 bit, JPEG, WebP, Radiance HDR and layered OpenEXR.

Reading returns float32 with channels as R, G, B(, A) and integer formats scaled to [0, 1]; transfer
curves are left as stored (see `spotlight_runtime.imaging.colour`). Writing is write-then-rename, so
a reader never meets half an image. A truncated or foreign file is an `ImageFileError`, never a
partly grey picture.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt
import OpenEXR

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import (
    DtypeError,
    ImageFileError,
    InvalidInputError,
    NonFiniteError,
    ShapeError,
)
from spotlight_runtime.imaging.decoding import decode_pixels, read_bytes, swap_red_blue
from spotlight_runtime.imaging.headers import check_header, read_header
from spotlight_spec import replacing

__all__ = [
    "check_place",
    "check_target",
    "encode_png",
    "read_exr_layers",
    "read_image",
    "write_exr_layers",
    "write_image",
    "write_jpeg",
]


_JPEG: Final = {".jpg", ".jpeg"}
_EIGHT_BIT: Final = {*_JPEG, ".webp"}
_READABLE: Final = {".png", ".hdr", ".exr", *_EIGHT_BIT}
_EXR_HEADER_BYTES: Final = 1 << 20  # attributes take a few hundred, a preview picture more
_EXR_MAGIC: Final = b"\x76\x2f\x31\x01"
_CHANNEL_ORDER: Final = {name: i for i, name in enumerate("RGBXYZVA")}


def read_image(path: str | Path) -> FloatArray:
    """Read an image file.

    Parameters
    ----------
    path : str or Path
        ``.png``, ``.jpg``/``.jpeg`` (EXIF orientation applied), ``.webp``, ``.hdr`` or ``.exr``
        (the layer without a name, or the only one).

    Returns
    -------
    ndarray of float32, shape (H, W) or (H, W, C) with C in {2, 3, 4}
        Integer formats in [0, 1]; floating-point formats as stored. Values are as encoded.

    Raises
    ------
    ImageFileError
        If the file is missing, truncated, or no image of these formats.
    """
    path = Path(path)
    if path.suffix.lower() not in _READABLE:
        raise ImageFileError(
            f"{path}: expected one of {', '.join(sorted(_READABLE))}, got {path.suffix!r}"
        )
    if path.suffix.lower() == ".exr":
        layers = read_exr_layers(path)
        if "" not in layers and len(layers) != 1:
            raise ImageFileError(
                f"{path}: expected one unnamed layer, got layers {', '.join(layers)}; "
                "split the file or name its layers as a published scene bundle"
            )
        return layers.get("", next(iter(layers.values())))
    return _as_float(decode_pixels(read_bytes(path), path))


def read_exr_layers(path: Path) -> dict[str, FloatArray]:
    """Read every layer of an OpenEXR file.

    Returns
    -------
    dict of ndarray of float32, shape (H, W) or (H, W, C)
        By layer name (``albedo`` of ``albedo.R``; "" for bare channels), channels in the order
        R G B X Y Z V A.

    Raises
    ------
    ImageFileError
        If the file is missing, truncated or not OpenEXR.
    """
    if not os.path.isfile(path):  # unlike Path.is_file, False for impossible names too
        raise ImageFileError(f"{path}: no such file")
    _check_exr_header(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError) as error:
        raise ImageFileError(f"{path}: expected a whole OpenEXR file, got {error}") from error
    grouped: dict[str, list[tuple[str, Any]]] = {}
    for name, pixels in channels.items():
        layer, _, channel = name.rpartition(".")
        grouped.setdefault(layer, []).append((channel, pixels))
    return {layer: _stack(members, path, layer) for layer, members in grouped.items()}


def write_image(path: str | Path, image: FloatArray, *, bits: int = 8, quality: int = 95) -> None:
    """Write an image file; values are stored as they are encoded, whatever the format.

    For maps and shadows; a finished picture goes by `picture_files.write_picture`.

    Parameters
    ----------
    path : str or Path
        ``.png``, ``.jpg``/``.jpeg``, ``.webp`` (values clipped to [0, 1]), ``.hdr`` or ``.exr``.
    image : ndarray of float32, shape (H, W) or (H, W, 3) or (H, W, 4)
    bits : {8, 16}
        Depth of a PNG.
    quality : int
        JPEG and WebP quality, 1 to 100.

    Raises
    ------
    InvalidInputError, DtypeError
        If the format cannot hold the image.
    ImageFileError
        If the file cannot be written.
    """
    path = Path(path)
    check_target(path)
    suffix = path.suffix.lower()
    if suffix == ".exr":
        write_exr_layers(path, {"": image})
        return
    _check_pixels(image, path)
    if suffix == ".hdr":
        data = _encode(".hdr", swap_red_blue(image.astype(np.float32)), [], path)
    elif suffix == ".png":
        data = _encode(".png", swap_red_blue(_quantise(image, bits, path)), [], path)
    else:
        key = cv2.IMWRITE_JPEG_QUALITY if suffix in _JPEG else cv2.IMWRITE_WEBP_QUALITY
        pixels = swap_red_blue(_quantise(image, 8, path))
        data = _encode(suffix, pixels, [int(key), quality], path)
    with _replacing(path) as partial:
        partial.write_bytes(data)


def write_jpeg(path: Path, pixels: npt.NDArray[np.uint8], quality: int = 95) -> None:
    """Write encoded RGB pixels, shape (H, W, 3), as they are: a large picture without floats."""
    options = [int(cv2.IMWRITE_JPEG_QUALITY), quality]
    data = _encode(".jpg", swap_red_blue(pixels), options, path)
    with _replacing(path) as partial:
        partial.write_bytes(data)


def check_target(path: Path) -> None:
    """Raise what `write_image` would of this name, before there is an image.

    Raises
    ------
    InvalidInputError
        If no image format goes by this suffix.
    ImageFileError
        As `check_place` says.
    """
    suffix = path.suffix.lower()
    if suffix not in _READABLE:
        raise InvalidInputError(
            f"{path}: expected one of {', '.join(sorted(_READABLE))}, got {suffix!r}"
        )
    check_place(path)


def check_place(path: Path) -> None:
    """Raise if no file can be written under this name, whatever it is to hold.

    Raises
    ------
    ImageFileError
        If it is a folder, or its folder does not exist, or cannot be written to.
    """
    if os.path.isdir(path):
        raise ImageFileError(f"{path}: cannot be written: it is a folder")
    if os.path.exists(path) and not os.path.isfile(path):  # a pipe, a device
        return
    folder = Path(os.path.realpath(path)).parent if os.path.islink(path) else path.parent
    if not os.path.isdir(folder):
        raise ImageFileError(f"{path}: cannot be written: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise ImageFileError(f"{path}: cannot be written: the folder {folder} is read-only")


def encode_png(image: FloatArray, *, bits: int = 8) -> bytes:
    """PNG bytes of an image with values in [0, 1] (clipped)."""
    path = Path("image.png")
    _check_pixels(image, path)
    return _encode(".png", swap_red_blue(_quantise(image, bits, path)), [], path)


def write_exr_layers(path: Path, layers: Mapping[str, npt.NDArray[np.floating[Any]]]) -> None:
    """Write arrays of shape (H, W) or (H, W, 1..4) as layers of one OpenEXR file, losslessly.

    float16 arrays are stored as half, others as float32. One channel is named V.
    """
    channels = {}
    for layer, image in layers.items():
        _check_pixels(image, path)
        pixels = image if image.dtype == np.float16 else image.astype(np.float32)
        planes = pixels[..., None] if pixels.ndim == 2 else pixels
        names = {1: "V", 2: "VA", 3: "RGB", 4: "RGBA"}[planes.shape[2]]
        for i, name in enumerate(names):
            key = f"{layer}.{name}" if layer else name
            channels[key] = np.ascontiguousarray(planes[..., i])
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with _replacing(path) as partial:
        OpenEXR.File(header, channels).write(str(partial))


def _as_float(pixels: npt.NDArray[Any]) -> FloatArray:
    if np.issubdtype(pixels.dtype, np.integer):
        return pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    return pixels.astype(np.float32)


def _check_exr_header(path: Path) -> None:
    """Raise where the header asks for more memory than a picture needs."""
    try:
        with path.open("rb") as file:
            start = file.read(_EXR_HEADER_BYTES)
    except OSError as error:
        raise ImageFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    if read_header(start) is not None:  # what else may be wrong, OpenEXR says better
        check_header(start, str(path))
    elif start.startswith(_EXR_MAGIC):
        raise ImageFileError(
            f"{path}: expected a whole OpenEXR file, its header is damaged or longer than "
            f"{_EXR_HEADER_BYTES >> 20} MiB; export it again"
        )


def _encode(suffix: str, pixels: npt.NDArray[Any], options: list[int], path: Path) -> bytes:
    problem = "the encoder failed"
    try:
        done, buffer = cv2.imencode(suffix, pixels, options)
    except cv2.error as error:
        done, problem = False, error.err
    if not done and suffix == ".hdr" and pixels.ndim == 3 and pixels.shape[2] == 3:
        # OpenCV makes these in a file of its own in the temporary folder.
        raise ImageFileError(
            f"{path}: cannot be written: {problem}; is the temporary folder full or read-only?"
        )
    if not done:
        raise InvalidInputError(f"{path}: {suffix} cannot hold an image of shape {pixels.shape}")
    return bytes(buffer)


def _check_pixels(image: FloatArray, path: Path) -> None:
    if not isinstance(image, np.ndarray) or not np.issubdtype(image.dtype, np.floating):
        got = getattr(image, "dtype", type(image).__name__)
        raise DtypeError(f"{path}: expected a float32 image, got {got}; convert it first")
    if not 2 <= image.ndim <= 3 or image.size == 0 or (image.ndim == 3 and image.shape[2] > 4):
        raise ShapeError(f"{path}: expected shape (H, W) or (H, W, 1..4), got {image.shape}")


def _quantise(image: FloatArray, bits: int, path: Path) -> npt.NDArray[Any]:
    if bits not in (8, 16):
        raise InvalidInputError(f"bits: expected 8 or 16, got {bits!r}")
    if not np.isfinite(image).all():
        raise NonFiniteError(f"{path}: the image holds NaN or infinity; pixels are in [0, 1]")
    levels = np.empty(image.shape, dtype=np.uint8 if bits == 8 else np.uint16)
    top = 2**bits - 1
    for row, values in enumerate(image):  # row by row: a photograph's worth of floats is much
        levels[row] = np.round(np.clip(values, 0.0, 1.0) * top)
    return levels


def _stack(members: list[tuple[str, Any]], path: Path, layer: str) -> FloatArray:
    members.sort(key=lambda member: _CHANNEL_ORDER.get(member[0], len(_CHANNEL_ORDER)))
    shapes = {pixels.shape for _, pixels in members}
    if len(shapes) != 1:
        raise ImageFileError(f"{path}: the channels of layer {layer!r} differ in size: {shapes}")
    planes = [np.asarray(pixels, dtype=np.float32) for _, pixels in members]
    return planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """`replacing`, with the errors of this module."""
    try:
        with replacing(path) as partial:
            yield partial
    except OSError as error:
        raise ImageFileError(f"{path}: cannot be written: {error.strerror or error}") from error
    except RuntimeError as error:  # OpenEXR's
        raise ImageFileError(f"{path}: cannot be written: {error}") from error
