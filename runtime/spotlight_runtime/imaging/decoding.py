"""Bytes to pixels as they are stored: PNG 8/16 bit, JPEG, WebP and Radiance HDR."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.errors import ImageFileError
from spotlight_runtime.imaging.headers import MAX_FILE_BYTES, check_header, jpeg_ends

__all__ = ["decode_pixels", "read_bytes", "swap_red_blue"]

SWAPPED_BY_OPENCV: Final = (np.uint8, np.uint16, np.float32)

_JPEG_SIGNATURE: Final = b"\xff\xd8\xff"
_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_SIGNATURES: Final = (_PNG_SIGNATURE, _JPEG_SIGNATURE, b"RIFF", b"#?")


def read_bytes(path: Path) -> bytes:
    """Read a file of ordinary size.

    Raises
    ------
    ImageFileError
        If it cannot be read, or is larger than any picture taken.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ImageFileError(
                f"{path}: expected at most {MAX_FILE_BYTES >> 20} MiB, "
                f"got {path.stat().st_size >> 20}; shrink the picture first"
            )
        return path.read_bytes()
    except OSError as error:
        if isinstance(error, ImageFileError):
            raise
        raise ImageFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # a name no file can have
        raise ImageFileError(f"{path!r}: cannot be read: {error}") from error


def decode_pixels(data: bytes, path: str | Path) -> npt.NDArray[Any]:
    """Decode PNG, JPEG, WebP or Radiance HDR bytes to pixels as they are stored.

    Parameters
    ----------
    data : bytes
    path : str or Path
        Named in errors.

    Returns
    -------
    ndarray of uint8, uint16 or float32, shape (H, W) or (H, W, C)
        Channels as R, G, B(, A).

    Raises
    ------
    ImageFileError
        If they are truncated, no image, or more pixels than `headers.MAX_PIXELS`.
    """
    if not data:
        raise ImageFileError(
            f"{path}: the file is empty; expected an image, export or download it again"
        )
    if not data.startswith(_SIGNATURES):
        raise ImageFileError(f"{path}: expected a PNG, JPEG, WebP or Radiance HDR file")
    check_header(data, str(path))
    end = _png_end(data, path) if data.startswith(_PNG_SIGNATURE) else len(data)
    if data.startswith(_JPEG_SIGNATURE):
        # Unlike the other decoders, libjpeg fills what is missing with grey and only warns.
        if not jpeg_ends(data):
            raise ImageFileError(f"{path}: the JPEG is truncated (no end-of-image marker)")
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH  # these flags apply the EXIF orientation
    else:
        flags = cv2.IMREAD_UNCHANGED
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8, count=end), flags)
    except cv2.error as error:
        raise ImageFileError(f"{path}: cannot be decoded: {error}") from error
    if pixels is None:
        raise ImageFileError(f"{path}: expected a whole image file, got {len(data)} other bytes")
    return swap_red_blue(pixels)


def _png_end(data: bytes, path: str | Path) -> int:
    """Where a PNG's last chunk ends, if all chunks up to it are as long as they say.

    OpenCV allocates what a chunk claims, up to four gigabytes, before it looks whether it is there;
    of a picture without pixels it goes on to what lies after the last one.
    """
    position = len(_PNG_SIGNATURE)
    while position + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        position += 12 + length
        if kind == b"IEND" and position <= len(data):
            return position
    raise ImageFileError(
        f"{path}: expected a whole image file, got a truncated PNG of {len(data)} bytes; "
        "export or download it again"
    )


def swap_red_blue(pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """RGB(A) to BGR(A) and back; grey stays."""
    if pixels.ndim == 2 or pixels.shape[2] < 3:
        return pixels
    if pixels.shape[2] <= 4 and pixels.dtype in SWAPPED_BY_OPENCV:  # twenty times as fast
        code = cv2.COLOR_RGB2BGR if pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        return np.asarray(cv2.cvtColor(pixels, code))
    order = [2, 1, 0, *range(3, pixels.shape[2])]
    return np.ascontiguousarray(pixels[..., order])
