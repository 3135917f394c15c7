"""What the first bytes of an image file say: size, orientation, focal length; nothing is decoded.

Decoders believe a header and allocate what it asks for. These readers look first, so a few hundred
bytes that claim a gigantic picture are refused before anything is allocated.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from spotlight_runtime.errors import ImageFileError

__all__ = [
    "MAX_FILE_BYTES",
    "MAX_PIXELS",
    "ImageHeader",
    "check_header",
    "jpeg_ends",
    "read_header",
]


MAX_PIXELS: Final = 64_000_000
"""Largest picture taken: a scene of that size holds eight gigabytes of maps."""
MAX_SAMPLES: Final = 1 << 29
"""Most numbers of an OpenEXR file, all its channels and parts together: two gigabytes as float32,
a published scene of forty channels at 13 megapixels."""
MAX_FILE_BYTES: Final = 1 << 30
"""Largest image file taken: a float32 EXR of `MAX_PIXELS` is three quarters of it."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_EXR: Final = b"\x76\x2f\x31\x01"
_NOT_FRAMES: Final = {0xC4, 0xC8, 0xCC}  # tables that share the start-of-frame range of markers
_TURNED: Final = {5, 6, 7, 8}  # EXIF orientations that swap width and height
_START_OF_SCAN: Final = 0xDA
_END_OF_IMAGE: Final = b"\xff\xd9"
_ORIENTATION, _EXIF_FOLDER, _FOCAL_35MM = 0x0112, 0x8769, 0xA405
_SHORT, _LONG = 3, 4  # TIFF field types
_HDR_HEADER_BYTES: Final = 1 << 16
_HDR_SIZE: Final = re.compile(rb"\n\n([-+][XY]) +(\d{1,9}) +([-+][XY]) +(\d{1,9})\n")
_EXR_MULTIPART: Final = 0x1000


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """What an image file says of itself.

    Attributes
    ----------
    width, height : int
        Pixels as they come out of the reader: the EXIF orientation of a JPEG is applied.
    focal_35mm : float, optional
        Focal length in millimetres on a 36×24 mm frame of the same diagonal.
    planes : int
        Channels of an OpenEXR file, of all its parts; of other files not read, 4 at most.
    """

    width: int
    height: int
    focal_35mm: float | None = None
    planes: int = field(default=4, compare=False)


def check_header(data: bytes, name: str) -> ImageHeader:
    """Read the header and raise where decoding would be a bad idea.

    Raises
    ------
    ImageFileError
        If there are no bytes, no header of a known format, or more than `MAX_PIXELS` pixels or
        `MAX_SAMPLES` numbers.
    """
    if not data:
        raise ImageFileError(
            f"{name}: expected an image, got an empty file; export or download it again"
        )
    header = read_header(data)
    if header is None:
        raise ImageFileError(
            f"{name}: expected a PNG, JPEG, WebP, Radiance HDR or OpenEXR file, got other bytes "
            "or a truncated header; export it again in one of these formats"
        )
    if header.width <= 0 or header.height <= 0:
        raise ImageFileError(
            f"{name}: expected pixels, the header says {header.width}×{header.height}; "
            "export it again"
        )
    if header.width * header.height > MAX_PIXELS:
        raise ImageFileError(
            f"{name}: expected at most {MAX_PIXELS // 1_000_000} megapixels, the header says "
            f"{header.width}×{header.height}; shrink the picture first"
        )
    if header.width * header.height * header.planes > MAX_SAMPLES:
        raise ImageFileError(
            f"{name}: expected at most {MAX_SAMPLES} numbers, the header says "
            f"{header.width}×{header.height} pixels of {header.planes} channels; shrink the "
            "picture, or leave out layers"
        )
    return header


def read_header(data: bytes) -> ImageHeader | None:
    """Read the header of PNG, JPEG, WebP, Radiance HDR or OpenEXR bytes; None for others."""
    try:
        if data.startswith(_PNG):
            return ImageHeader(*struct.unpack_from(">II", data, 16))
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp(data)
        if data.startswith(b"#?"):
            return _radiance(data)
        if data.startswith(_EXR):
            return _openexr(data)
    except (struct.error, IndexError, ValueError):  # the header ends too early
        return None
    return None


def jpeg_ends(data: bytes) -> bool:
    """Whether an end marker follows the pixels of a JPEG, whatever may be appended to it.

    A camera's preview before them has an end of its own, and the film that a phone appends may hold
    any bytes; among the pixels no marker comes by chance.
    """
    pixels = 0
    for marker, _, end in _jpeg_segments(data):
        pixels = end
        if marker == _START_OF_SCAN:
            break
    return data.find(_END_OF_IMAGE, pixels) >= 0


def _jpeg(data: bytes) -> ImageHeader | None:
    orientation, focal = 1, None
    for marker, body, end in _jpeg_segments(data):
        if marker == 0xE1 and data[body : body + 6] == b"Exif\0\0":
            orientation, focal = _exif(data[body + 6 : end])
        elif 0xC0 <= marker <= 0xCF and marker not in _NOT_FRAMES:
            height, width = struct.unpack_from(">HH", data, body + 1)
            if orientation in _TURNED:
                width, height = height, width
            return ImageHeader(width, height, focal)
    return None


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, begin and end of what a JPEG's segments hold, up to the first scan's pixels."""
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        if marker == 0xFF:  # padding
            position += 1
            continue
        if marker == 0x01 or 0xD0 <= marker <= 0xD8:  # markers without a length
            position += 2
            continue
        (length,) = struct.unpack_from(">H", data, position + 2)
        yield marker, position + 4, position + 2 + length
        position += 2 + length


def _exif(tiff: bytes) -> tuple[int, float | None]:
    """Orientation and 35 mm focal length of an EXIF block; (1, None) where it is damaged."""
    try:
        order = {b"II": "<", b"MM": ">"}[tiff[:2]]
        main = dict(_tiff_fields(tiff, struct.unpack_from(order + "I", tiff, 4)[0], order))
        extra = dict(_tiff_fields(tiff, main[_EXIF_FOLDER], order)) if _EXIF_FOLDER in main else {}
    except (KeyError, struct.error):
        return 1, None
    return main.get(_ORIENTATION, 1), float(extra.get(_FOCAL_35MM, 0)) or None


def _tiff_fields(tiff: bytes, offset: int, order: str) -> Iterator[tuple[int, int]]:
    """Tags and values of the whole-number fields of one TIFF directory."""
    (count,) = struct.unpack_from(order + "H", tiff, offset)
    for entry in range(offset + 2, offset + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", tiff, entry)
        if kind in (_SHORT, _LONG):
            code = "H" if kind == _SHORT else "I"
            yield tag, struct.unpack_from(order + code, tiff, entry + 8)[0]


def _webp(data: bytes) -> ImageHeader | None:
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return ImageHeader(width & 0x3FFF, height & 0x3FFF)
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return ImageHeader((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[i : i + 3], "little") + 1 for i in (24, 27))
        return ImageHeader(width, height)
    return None


def _radiance(data: bytes) -> ImageHeader | None:
    # The size follows the first empty line; a line like it among the comments says nothing.
    found = _HDR_SIZE.match(data, max(0, data.find(b"\n\n", 0, _HDR_HEADER_BYTES)))
    if found is None:
        return None
    sides = {found[1][1:]: int(found[2]), found[3][1:]: int(found[4])}
    return ImageHeader(sides[b"X"], sides[b"Y"]) if len(sides) == 2 else None


def _openexr(data: bytes) -> ImageHeader | None:
    """The largest data window and the number of channels of all parts.

    A part's header is a list of attributes (name, type, size, value) that ends with an empty name;
    an attribute that is given twice counts twice, whichever of them the decoder believes.
    """
    (version,) = struct.unpack_from("<I", data, 4)
    position, planes = 8, 0
    sizes: list[tuple[int, int]] = []
    while True:
        while data[position] != 0:
            name_end = data.index(b"\0", position)
            type_end = data.index(b"\0", name_end + 1)
            (size,) = struct.unpack_from("<i", data, type_end + 1)
            value = type_end + 5
            if data[position:name_end] == b"dataWindow":
                left, top, right, bottom = struct.unpack_from("<4i", data, value)
                sizes.append((right - left + 1, bottom - top + 1))
            elif data[position:name_end] == b"channels":
                planes += _exr_channels(data[value : value + max(size, 0)])
            if size < 0:
                return None
            position = value + size
        position += 1
        if not version & _EXR_MULTIPART or data[position] == 0:
            break
    if not sizes:
        return None
    least = min(sizes, key=min)
    widest = max(width for width, _ in sizes), max(height for _, height in sizes)
    return ImageHeader(*(least if min(least) <= 0 else widest), planes=planes)


def _exr_channels(listed: bytes) -> int:
    """How many channels a list of (name, sixteen bytes) holds."""
    position = count = 0
    while position < len(listed) and listed[position] != 0:
        position = listed.index(b"\0", position) + 17
        count += 1
    return count
