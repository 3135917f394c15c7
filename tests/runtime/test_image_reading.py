"""Image files in: every format, and whatever else may lie under such a name."""

import struct
import zlib

import cv2
import numpy as np
import OpenEXR
import pytest

from spotlight_runtime import read_image, write_image
from spotlight_runtime.errors import ImageFileError
from spotlight_runtime.imaging.images import read_exr_layers, write_exr_layers

FORMATS = [".png", ".jpg", ".webp", ".hdr", ".exr"]


@pytest.fixture
def picture(rng):
    """Smooth enough for JPEG, noisy enough for files of some length."""
    ramp = np.linspace(0.1, 0.8, 40 * 56, dtype=np.float32).reshape(40, 56, 1)
    return (ramp * np.float32([1.0, 0.6, 0.3]) + 0.1 * rng.random((40, 56, 3))).astype(np.float32)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".jpeg", ".webp", ".hdr", ".exr", ".PNG"])
def test_channels_come_as_red_green_blue(suffix, tmp_path):
    path = tmp_path / f"colour{suffix}"
    write_image(path, np.full((16, 16, 3), [0.9, 0.5, 0.1], np.float32))
    image = read_image(path)
    assert image.dtype == np.float32
    assert image.shape == (16, 16, 3)
    np.testing.assert_allclose(image.mean((0, 1)), [0.9, 0.5, 0.1], atol=0.02)


def test_text_is_a_path_too(tmp_path, picture):
    write_image(str(tmp_path / "a.png"), picture)
    assert read_image(str(tmp_path / "a.png")).shape == picture.shape


@pytest.mark.parametrize("suffix", FORMATS)
def test_truncated_anywhere_it_is_an_error_never_a_picture(suffix, tmp_path, picture):
    whole, cut = tmp_path / f"whole{suffix}", tmp_path / f"cut{suffix}"
    write_image(whole, picture)
    data = whole.read_bytes()
    n = len(data)
    offsets = {*range(24), *range(n - 16, n), *np.linspace(24, n - 16, 60).astype(int).tolist()}
    for offset in sorted(offsets):
        cut.write_bytes(data[:offset])
        with pytest.raises(ImageFileError, match=r"cut\."):
            read_image(cut)


@pytest.mark.parametrize("grey", [False, True])
def test_truncated_sixteen_bit_png(tmp_path, picture, grey):
    path = tmp_path / "deep.png"
    write_image(path, picture[..., 0] if grey else picture, bits=16)
    data = path.read_bytes()
    for offset in np.linspace(0, len(data) - 1, 50).astype(int):
        path.write_bytes(data[:offset])
        with pytest.raises(ImageFileError):
            read_image(path)


def test_truncated_progressive_jpeg(tmp_path, picture):
    pixels = (picture * 255).astype(np.uint8)
    data = bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1])
    path = tmp_path / "progressive.jpg"
    path.write_bytes(data)
    assert read_image(path).shape == picture.shape
    for offset in np.linspace(0, len(data) - 1, 80).astype(int):
        path.write_bytes(data[:offset])
        with pytest.raises(ImageFileError):
            read_image(path)


FILM = b"\0\0\0\x18ftypmp42" + bytes(range(256)) * 8 + b"\xff\xda\0\x08 no end of an image here"


@pytest.mark.parametrize("flags", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]], ids=["plain", "waves"])
def test_whole_jpeg_with_a_film_appended(flags, tmp_path, picture):
    """Phones append an MP4 to a picture in motion."""
    data = bytes(cv2.imencode(".jpg", (picture * 255).astype(np.uint8), flags)[1])
    (tmp_path / "still.jpg").write_bytes(data)
    (tmp_path / "motion.jpg").write_bytes(data + FILM)
    np.testing.assert_array_equal(
        read_image(tmp_path / "motion.jpg"), read_image(tmp_path / "still.jpg")
    )


def test_truncated_jpeg_with_a_preview_that_is_whole(tmp_path, picture):
    """The end of an image within a segment is not the picture's."""
    pixels = (picture * 255).astype(np.uint8)
    preview = bytes(cv2.imencode(".jpg", pixels)[1])
    segment = b"\xff\xe2" + struct.pack(">H", len(preview) + 2) + preview
    data = preview[:2] + segment + preview[2:]
    path = tmp_path / "preview.jpg"
    path.write_bytes(data)
    assert read_image(path).shape == picture.shape
    for kept in (len(segment) + 2, len(segment) + 300, len(data) - 300, len(data) - 2):
        path.write_bytes(data[:kept])
        with pytest.raises(ImageFileError):
            read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".webp", ".hdr"])
def test_truncated_jpeg_is_no_picture_under_another_name(suffix, tmp_path, picture):
    write_image(tmp_path / "whole.jpg", picture)
    data = (tmp_path / "whole.jpg").read_bytes()
    for missing in (1, 2, 3, 100, 1000):
        path = tmp_path / f"cut{suffix}"
        path.write_bytes(data[:-missing])
        with pytest.raises(ImageFileError):
            read_image(path)


def test_flipped_bits_of_a_png_are_noticed(tmp_path, picture):
    """PNG has checksums; what is not noticed must be in bytes that carry no pixel."""
    path = tmp_path / "flipped.png"
    write_image(path, picture)
    data = path.read_bytes()
    start = data.index(b"IDAT")
    for offset in np.linspace(start, len(data) - 20, 40).astype(int):
        spoiled = bytearray(data)
        spoiled[offset] ^= 0x10
        path.write_bytes(spoiled)
        with pytest.raises(ImageFileError):
            read_image(path)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 4096, b"not an image\n" * 50, b"<svg/>", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"],
    ids=["empty", "zeros", "text", "svg", "png signature", "jpeg signature"],
)
def test_foreign_bytes_are_named(suffix, data, tmp_path):
    path = tmp_path / f"foreign{suffix}"
    path.write_bytes(data)
    with pytest.raises(ImageFileError, match=r"foreign\."):
        read_image(path)


@pytest.mark.parametrize("foreign", [".bmp", ".tiff", ".ppm", ".jp2", ".gif"])
def test_formats_that_are_not_ours_are_foreign_whatever_their_name(foreign, tmp_path, picture):
    """Their decoders promise nothing about truncated files."""
    if not cv2.haveImageWriter(f"x{foreign}"):
        pytest.skip(f"this OpenCV writes no {foreign}")
    data = cv2.imencode(foreign, (picture * 255).astype(np.uint8))[1]
    path = tmp_path / "renamed.png"
    path.write_bytes(bytes(data))
    with pytest.raises(ImageFileError, match=r"renamed\.png"):
        read_image(path)


def test_png_that_claims_a_huge_size(tmp_path):
    header = struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 8, 2, 0, 0, 0)
    chunk = b"IHDR" + header
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk
    path = tmp_path / "huge.png"
    path.write_bytes(data + struct.pack(">I", zlib.crc32(chunk)))
    with pytest.raises(ImageFileError, match=r"huge\.png"):
        read_image(path)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("name", ["missing", "null\0byte", "n" * 300, "lone \ud800 surrogate"])
def test_what_is_not_there_is_one_error(suffix, name, tmp_path):
    with pytest.raises(ImageFileError):
        read_image(tmp_path / f"{name}{suffix}")


@pytest.mark.parametrize("suffix", FORMATS)
def test_folder_is_no_image(suffix, tmp_path):
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(ImageFileError, match="folder"):
        read_image(tmp_path / f"folder{suffix}")


@pytest.mark.parametrize("name", ["scene.gif", "scene", "scene.png.txt", ".png"])
def test_other_suffixes_are_named_with_the_known_ones(name, tmp_path):
    with pytest.raises(ImageFileError, match=r"expected one of \.exr, \.hdr, \.jpeg"):
        read_image(tmp_path / name)


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (16, np.uint16)])
@pytest.mark.parametrize("channels", [None, 3, 4])
def test_png_values_are_exact_fractions(bits, dtype, channels, tmp_path, rng):
    top = 2**bits - 1
    shape = (17, 9) if channels is None else (17, 9, channels)
    stored = rng.integers(0, top + 1, shape).astype(dtype)
    path = tmp_path / "exact.png"
    write_image(path, stored.astype(np.float32) / np.float32(top), bits=bits)
    image = read_image(path)
    assert image.shape == shape
    np.testing.assert_array_equal(np.round(image * top), stored)


def exif(orientation):
    """The smallest EXIF segment: one tag, the orientation."""
    tiff = b"II*\0\x08\0\0\0" + struct.pack("<HHHIHHI", 1, 0x0112, 3, 1, orientation, 0, 0)
    body = b"Exif\0\0" + tiff
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body


@pytest.mark.parametrize("orientation", range(1, 9))
def test_jpeg_is_turned_as_the_camera_was(orientation, tmp_path):
    """A picture whose left half is white; where the white goes tells the orientation."""
    picture = np.zeros((32, 64, 3), np.float32)
    picture[:, :32] = 1.0
    picture[:16] *= 0.5
    path = tmp_path / "turned.jpg"
    write_image(path, picture, quality=100)
    plain = read_image(path)
    data = path.read_bytes()
    path.write_bytes(data[:2] + exif(orientation) + data[2:])
    turned = {
        1: plain,
        2: plain[:, ::-1],
        3: plain[::-1, ::-1],
        4: plain[::-1],
        5: plain.transpose(1, 0, 2),
        6: plain.transpose(1, 0, 2)[:, ::-1],
        7: plain[::-1, ::-1].transpose(1, 0, 2),
        8: plain.transpose(1, 0, 2)[::-1],
    }[orientation]
    np.testing.assert_array_equal(read_image(path), turned)


def test_grey_jpeg_has_three_equal_channels(tmp_path, picture):
    write_image(tmp_path / "grey.jpg", picture[..., 0])
    image = read_image(tmp_path / "grey.jpg")
    assert np.ptp(image, axis=-1).max() == 0.0


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("channels", [None, 1, 2, 3, 4])
def test_exr_keeps_every_bit(dtype, channels, tmp_path, rng):
    shape = (6, 5) if channels is None else (6, 5, channels)
    values = (100.0 * rng.standard_normal(shape)).astype(dtype)
    write_exr_layers(tmp_path / "a.exr", {"": values})
    image = read_image(tmp_path / "a.exr")
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image.reshape(shape), values.astype(np.float32))


def test_exr_keeps_what_is_not_finite_for_the_scene_to_refuse(tmp_path):
    values = np.float32([[np.nan, np.inf], [-np.inf, -0.0]])
    write_image(tmp_path / "odd.exr", values)
    np.testing.assert_array_equal(read_image(tmp_path / "odd.exr"), values)


def test_exr_layers_keep_names_and_order(tmp_path, rng):
    layers = {
        "": rng.random((4, 6, 3), dtype=np.float32),
        "albedo": rng.random((4, 6, 4), dtype=np.float32),
        "object.depth": rng.random((4, 6, 2), dtype=np.float32),
        "mask": rng.random((4, 6), dtype=np.float32),
    }
    write_exr_layers(tmp_path / "layers.exr", layers)
    found = read_exr_layers(tmp_path / "layers.exr")
    assert found.keys() == layers.keys()
    for name, values in layers.items():
        np.testing.assert_array_equal(found[name], values)
    np.testing.assert_array_equal(read_image(tmp_path / "layers.exr"), layers[""])


def test_single_named_layer_is_the_image(tmp_path):
    values = np.ones((4, 6, 3), np.float32)
    write_exr_layers(tmp_path / "one.exr", {"albedo": values})
    np.testing.assert_array_equal(read_image(tmp_path / "one.exr"), values)


def test_several_named_layers_are_no_single_image(tmp_path):
    values = np.ones((4, 6, 3), np.float32)
    write_exr_layers(tmp_path / "two.exr", {"albedo": values, "depth": values[..., 0]})
    with pytest.raises(ImageFileError, match="got layers albedo, depth"):
        read_image(tmp_path / "two.exr")


def test_normals_come_as_x_y_z(tmp_path, rng):
    planes = {f"N.{axis}": rng.random((4, 6), dtype=np.float32) for axis in "ZXY"}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, dict(planes)).write(str(tmp_path / "n.exr"))
    image = read_image(tmp_path / "n.exr")
    for i, axis in enumerate("XYZ"):
        np.testing.assert_array_equal(image[..., i], planes[f"N.{axis}"])


def test_damaged_exr_header_is_one_error(tmp_path, picture):
    path = tmp_path / "h.exr"
    write_image(path, picture)
    data = path.read_bytes()
    for offset in range(0, 400, 3):
        for value in (0x00, 0x7F, 0xFF):
            spoiled = bytearray(data)
            spoiled[offset] = value
            path.write_bytes(spoiled)
            try:
                read_exr_layers(path)
            except ImageFileError:
                continue


@pytest.mark.parametrize("suffix", FORMATS)
def test_unreadable_name_says_what_it_was(suffix, tmp_path):
    with pytest.raises(OSError, match="missing"):
        read_image(tmp_path / f"missing{suffix}")
