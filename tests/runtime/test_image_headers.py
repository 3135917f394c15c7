"""What image files say of themselves before they are decoded, and what is refused for it."""

import struct
import zlib

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.pictures import exif, jpeg_with_exif

from spotlight_runtime import read_image, write_image
from spotlight_runtime.errors import ImageFileError
from spotlight_runtime.imaging.headers import MAX_PIXELS, ImageHeader, check_header, read_header


def png_claiming(width, height):
    """A few bytes of PNG that claim to be any size."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunk = b"IHDR" + header
    return (
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    )


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".hdr", ".exr"])
@pytest.mark.parametrize("shape", [(5, 7), (40, 33)])
def test_header_says_what_the_decoder_finds(tmp_path, rng, suffix, shape):
    path = tmp_path / f"picture{suffix}"
    write_image(path, rng.random((*shape, 3), dtype=np.float32))
    header = read_header(path.read_bytes())
    assert header == ImageHeader(shape[1], shape[0])
    assert read_image(path).shape[:2] == shape


@pytest.mark.parametrize(
    ("flags", "channels"), [([cv2.IMWRITE_WEBP_QUALITY, 101], 3), ([], 4), ([], 3)]
)
def test_every_kind_of_webp(rng, flags, channels):
    pixels = rng.integers(0, 255, (20, 30, channels), dtype=np.uint8)
    data = cv2.imencode(".webp", pixels, flags)[1].tobytes()
    assert read_header(data) == ImageHeader(30, 20)


def test_exr_with_a_window_that_begins_elsewhere(tmp_path):
    pixels = np.zeros((6, 9), np.float32)
    path = tmp_path / "offset.exr"
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": (np.array([-3, 10], np.int32), np.array([5, 15], np.int32)),
    }
    OpenEXR.File(header, {"V": pixels}).write(str(path))
    assert read_header(path.read_bytes()) == ImageHeader(9, 6)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_and_focal_length(rng, order, orientation):
    pixels = rng.integers(0, 255, (20, 30, 3), dtype=np.uint8)
    data = jpeg_with_exif(pixels, exif(orientation, 28, order))
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    header = read_header(data)
    assert (header.height, header.width) == decoded.shape[:2]
    assert header.focal_35mm == 28.0


@pytest.mark.parametrize("damaged", [b"", b"II", b"II*\0\xff\xff\xff\xff", b"XX*\0\x08\0\0\0\x01"])
def test_damaged_exif_is_as_if_there_were_none(rng, damaged):
    pixels = rng.integers(0, 255, (20, 30, 3), dtype=np.uint8)
    assert read_header(jpeg_with_exif(pixels, damaged)) == ImageHeader(30, 20)


@given(
    st.binary(max_size=200),
    st.sampled_from(
        [
            b"",
            b"\x89PNG\r\n\x1a\n",
            b"\xff\xd8\xff\xe1",
            b"RIFF1234WEBPVP8X",
            b"RIFF1234WEBPVP8L",
            b"#?RADIANCE\n",
            b"\x76\x2f\x31\x01\2\0\0\0dataWindow\0box2i\0",
        ]
    ),
)
def test_any_bytes_are_a_header_or_none(data, start):
    header = read_header(start + data)
    assert header is None or isinstance(header, ImageHeader)


@pytest.mark.parametrize("size", [(65_535, 65_535), (2**31 - 1, 2**31 - 1), (MAX_PIXELS + 1, 1)])
def test_decompression_bomb_is_refused_by_its_header(tmp_path, size):
    path = tmp_path / "bomb.png"
    path.write_bytes(png_claiming(*size))
    with pytest.raises(ImageFileError, match=r"bomb\.png.*at most 64 megapixels.*shrink"):
        read_image(path)


def test_exr_bomb_is_refused_by_its_header(tmp_path):
    path = tmp_path / "bomb.exr"
    write_image(path, np.zeros((4, 4), np.float32))
    data = bytearray(path.read_bytes())
    at = data.index(b"dataWindow") + len(b"dataWindow\0box2i\0") + 4
    data[at : at + 16] = struct.pack("<4i", 0, 0, 99_999, 99_999)
    path.write_bytes(bytes(data))
    with pytest.raises(ImageFileError, match=r"at most 64 megapixels.*100000×100000"):
        read_image(path)


def test_the_largest_allowed_is_allowed():
    check_header(png_claiming(8000, 8000), "large.png")


@pytest.mark.parametrize("data", [png_claiming(0, 5), png_claiming(5, 0)])
def test_no_pixels(data):
    with pytest.raises(ImageFileError, match="expected pixels"):
        check_header(data, "none.png")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".hdr", ".exr"])
def test_zero_byte_file(tmp_path, suffix):
    path = tmp_path / f"empty{suffix}"
    path.touch()
    with pytest.raises(ImageFileError, match="empty"):
        read_image(path)


def test_no_bytes_and_other_bytes_are_said():
    with pytest.raises(ImageFileError, match="empty file"):
        check_header(b"", "a.png")
    with pytest.raises(ImageFileError, match="expected a PNG, JPEG"):
        check_header(b"hello", "a.png")


def test_file_larger_than_any_picture(tmp_path):
    path = tmp_path / "huge.png"
    with path.open("wb") as file:
        file.truncate((1 << 30) + 1)  # sparse: takes no room
    with pytest.raises(ImageFileError, match=r"at most 1024 MiB"):
        read_image(path)
