"""Image files out: whole or not at all."""

import os
import subprocess
import sys
import textwrap

import cv2
import numpy as np
import pytest

from spotlight_runtime import read_image, write_image
from spotlight_runtime.errors import ImageFileError, InvalidInputError, SpotLightError
from spotlight_runtime.imaging.images import encode_png, read_exr_layers, write_exr_layers

FORMATS = [".png", ".jpg", ".webp", ".hdr", ".exr"]
IMAGE = np.full((8, 8, 3), 0.5, np.float32)


@pytest.mark.parametrize("suffix", FORMATS)
def test_nothing_is_left_beside_the_file(suffix, tmp_path):
    write_image(tmp_path / f"a{suffix}", IMAGE)
    assert [p.name for p in tmp_path.iterdir()] == [f"a{suffix}"]


@pytest.mark.parametrize("suffix", FORMATS)
def test_written_twice_it_is_the_same_bytes(suffix, tmp_path, rng):
    image = rng.random((9, 7, 3), dtype=np.float32)
    for name in ("a", "b"):
        write_image(tmp_path / f"{name}{suffix}", image)
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_file_is_replaced_never_rewritten(suffix, tmp_path):
    """Who holds the old file open goes on reading the old picture."""
    path = tmp_path / f"a{suffix}"
    write_image(path, IMAGE)
    old = path.read_bytes()
    with path.open("rb") as stream:
        write_image(path, np.zeros_like(IMAGE))
        assert stream.read() == old
    assert path.read_bytes() != old


@pytest.mark.parametrize("suffix", FORMATS)
def test_others_may_read_the_file(suffix, tmp_path):
    write_image(tmp_path / f"a{suffix}", IMAGE)
    assert (tmp_path / f"a{suffix}").stat().st_mode & 0o444 == 0o444


@pytest.mark.parametrize("suffix", FORMATS)
def test_missing_folder_is_named(suffix, tmp_path):
    with pytest.raises(ImageFileError, match="nowhere"):
        write_image(tmp_path / f"nowhere/a{suffix}", IMAGE)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
@pytest.mark.parametrize("suffix", FORMATS)
def test_unwritable_folder_is_named(suffix, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ImageFileError, match="cannot be written"):
        write_image(tmp_path / f"a{suffix}", IMAGE)
    tmp_path.chmod(0o700)


@pytest.mark.parametrize("suffix", FORMATS)
def test_file_in_place_of_the_folder_is_named(suffix, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ImageFileError, match="cannot be written"):
        write_image(tmp_path / f"file/a{suffix}", IMAGE)


@pytest.mark.parametrize("suffix", FORMATS)
def test_folder_in_place_of_the_file_is_named_and_nothing_is_left(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    path.mkdir()
    with pytest.raises(ImageFileError, match="cannot be written"):
        write_image(path, IMAGE)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(sys.platform == "win32", reason="needs file size limits")
@pytest.mark.parametrize("suffix", FORMATS)
def test_full_disk_keeps_the_old_picture_and_leaves_nothing(suffix, tmp_path):
    """A limit on file size stands in for a full disk: the write itself fails half way."""
    path = tmp_path / f"a{suffix}"
    write_image(path, IMAGE)
    old = path.read_bytes()
    script = """
        import resource, sys
        from pathlib import Path
        import numpy as np
        from spotlight_runtime import write_image
        from spotlight_runtime.errors import SpotLightError

        noise = np.random.default_rng(0).random((200, 200, 3), dtype=np.float32)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
        try:
            write_image(Path(sys.argv[1]), noise)
        except SpotLightError as error:
            assert str(error).startswith(sys.argv[1]), error
            sys.exit(7)
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 7, done.stderr
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["a.gif", "a", "a.tif"])
def test_unknown_suffix_is_named(name, tmp_path):
    with pytest.raises(InvalidInputError, match=r"expected one of \.exr"):
        write_image(tmp_path / name, IMAGE)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("shape", [(), (8,), (0, 8, 3), (8, 0), (8, 8, 5), (8, 8, 0), (1, 8, 8, 3)])
def test_what_no_format_holds_is_refused(suffix, shape, tmp_path):
    with pytest.raises(SpotLightError):
        write_image(tmp_path / f"a{suffix}", np.zeros(shape, np.float32))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".hdr"])
def test_two_channels_fit_only_exr(suffix, tmp_path):
    with pytest.raises(InvalidInputError, match=r"shape \(8, 8, 2\)"):
        write_image(tmp_path / f"a{suffix}", np.zeros((8, 8, 2), np.float32))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_no_pixels_are_refused(suffix, bad, tmp_path):
    image = IMAGE.copy()
    image[3, 4, 1] = bad
    with pytest.raises(InvalidInputError):
        write_image(tmp_path / f"a{suffix}", image)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int64, bool])
def test_integers_are_not_taken_for_fractions(suffix, dtype, tmp_path):
    """7 of 255 must not be saved as white."""
    with pytest.raises(SpotLightError, match="float32"):
        write_image(tmp_path / f"a{suffix}", np.full((8, 8, 3), 7).astype(dtype))


@pytest.mark.parametrize("bits", [0, 1, 12, 32, -8])
def test_png_has_8_or_16_bits(bits, tmp_path):
    with pytest.raises(InvalidInputError, match="bits: expected 8 or 16"):
        write_image(tmp_path / "a.png", IMAGE, bits=bits)


@pytest.mark.parametrize("bits", [8, 16])
def test_values_are_clipped_and_rounded_to_nearest(bits, tmp_path):
    top = 2**bits - 1
    values = np.float32([[-0.5, 0.4 / top, 0.6 / top, 1.0 - 0.4 / top, 1.0, 1.5, -0.0]])
    write_image(tmp_path / "a.png", values, bits=bits)
    stored = np.round(read_image(tmp_path / "a.png") * top)
    np.testing.assert_array_equal(stored, [[0, 0, 1, top, top, top, 0]])


def test_encoded_png_is_the_file(tmp_path):
    write_image(tmp_path / "a.png", IMAGE)
    assert encode_png(IMAGE) == (tmp_path / "a.png").read_bytes()
    assert cv2.imdecode(np.frombuffer(encode_png(IMAGE, bits=16), np.uint8), -1).dtype == np.uint16


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_lower_quality_is_a_smaller_file(suffix, tmp_path, rng):
    image = rng.random((64, 64, 3), dtype=np.float32)
    sizes = []
    for quality in (95, 20):
        write_image(tmp_path / f"a{suffix}", image, quality=quality)
        sizes.append((tmp_path / f"a{suffix}").stat().st_size)
    assert sizes[1] < 0.7 * sizes[0]


@pytest.mark.parametrize("suffix", FORMATS)
def test_layout_in_memory_does_not_matter(suffix, tmp_path, rng):
    image = rng.random((16, 12, 3), dtype=np.float32)
    write_image(tmp_path / f"a{suffix}", image)
    wanted = (tmp_path / f"a{suffix}").read_bytes()
    frozen = image.copy()
    frozen.setflags(write=False)
    turned = np.ascontiguousarray(image[::-1, ::-1])[::-1, ::-1]
    for other in (np.asfortranarray(image), turned, frozen, image.astype(np.float64)):
        write_image(tmp_path / f"b{suffix}", other)
        assert (tmp_path / f"b{suffix}").read_bytes() == wanted


def test_hdr_keeps_bright_values(tmp_path):
    image = np.full((8, 8, 3), [1000.0, 10.0, 0.01], np.float32)
    write_image(tmp_path / "sky.hdr", image)
    got = read_image(tmp_path / "sky.hdr")
    # Radiance shares one exponent: 8 bits of the brightest channel.
    np.testing.assert_allclose(got, image, atol=1000.0 / 128)


def test_half_stays_half_on_disk(tmp_path, rng):
    noise = rng.random((64, 64, 3), dtype=np.float32)
    write_exr_layers(tmp_path / "half.exr", {"": noise.astype(np.float16)})
    write_exr_layers(tmp_path / "full.exr", {"": noise})
    half, full = ((tmp_path / f"{n}.exr").stat().st_size for n in ("half", "full"))
    assert half < 0.6 * full
    np.testing.assert_array_equal(
        read_exr_layers(tmp_path / "half.exr")[""], noise.astype(np.float16).astype(np.float32)
    )


def test_names_of_all_scripts_are_names(tmp_path):
    for suffix in FORMATS:
        path = tmp_path / f"chaise été 椅子{suffix}"
        write_image(path, IMAGE)
        assert read_image(path).shape == IMAGE.shape
