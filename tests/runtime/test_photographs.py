"""Photographs as cameras and renderers write them, and views of panoramas."""

import math

import numpy as np
import pytest
from support.pictures import exif, jpeg_with_exif

from spotlight_runtime import write_image
from spotlight_runtime.composing.photograph import (
    Photograph,
    crop_panorama,
    expose,
    horizon_of,
    read_photograph,
)
from spotlight_runtime.errors import (
    ImageFileError,
    InvalidInputError,
    NonFiniteError,
    ShapeError,
)
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.imaging.colour import srgb_to_linear


def test_encoded_picture_becomes_linear_light(tmp_path, rng):
    pixels = rng.random((40, 50, 3), dtype=np.float32)
    for bits in (8, 16):
        write_image(tmp_path / "p.png", pixels, bits=bits)
        photograph = read_photograph(tmp_path / "p.png")
        top = 2**bits - 1
        wanted = srgb_to_linear(np.round(pixels * top) / np.float32(top))
        np.testing.assert_allclose(photograph.radiance, wanted, atol=1e-6)
        assert photograph.radiance.dtype == np.float32
        assert photograph.size == (40, 50)
        assert photograph.name == "p"


def test_grey_is_repeated_and_alpha_left_out(tmp_path, rng):
    grey = rng.random((40, 50), dtype=np.float32)
    write_image(tmp_path / "grey.png", grey)
    radiance = read_photograph(tmp_path / "grey.png").radiance
    assert (radiance == radiance[..., :1]).all()
    colour = rng.random((40, 50, 4), dtype=np.float32)
    write_image(tmp_path / "alpha.png", colour)
    write_image(tmp_path / "opaque.png", colour[..., :3])
    with_alpha, without = (read_photograph(tmp_path / f"{n}.png") for n in ("alpha", "opaque"))
    np.testing.assert_array_equal(with_alpha.radiance, without.radiance)


def test_orientation_is_applied(tmp_path):
    pixels = np.zeros((40, 60, 3), np.uint8)
    pixels[:, :30] = 255  # the left half is white
    path = tmp_path / "turned.jpg"
    path.write_bytes(jpeg_with_exif(pixels, exif(6)))  # turned by 90 degrees clockwise
    photograph = read_photograph(path)
    assert photograph.size == (60, 40)
    assert photograph.radiance[:25].min() > 0.9
    assert photograph.radiance[35:].max() < 0.1


@pytest.mark.parametrize(("size", "focal"), [((40, 60), 28), ((60, 40), 28), ((48, 64), 50)])
def test_field_of_view_from_exif(tmp_path, rng, size, focal):
    path = tmp_path / "camera.jpg"
    pixels = rng.integers(0, 255, (*size, 3), dtype=np.uint8)
    path.write_bytes(jpeg_with_exif(pixels, exif(1, focal)))
    camera = read_photograph(path).camera
    diagonal = 2 * math.degrees(
        math.atan(math.hypot(camera.width, camera.height) / 2 / camera.focal)
    )
    assert diagonal == pytest.approx(2 * math.degrees(math.atan(math.hypot(36, 24) / 2 / focal)))
    assert read_photograph(path, 33.0).field_of_view == 33.0


def test_no_field_of_view_is_not_the_usual_one(tmp_path, rng):
    write_image(tmp_path / "p.jpg", rng.random((40, 50, 3), dtype=np.float32))
    photograph = read_photograph(tmp_path / "p.jpg", 0.0)
    with pytest.raises(InvalidInputError, match="field_of_view: expected degrees"):
        _ = photograph.camera


def test_without_exif_fifty_degrees(tmp_path, rng):
    write_image(tmp_path / "p.jpg", rng.random((40, 50, 3), dtype=np.float32))
    assert read_photograph(tmp_path / "p.jpg").field_of_view == 50.0
    path = tmp_path / "unknown.jpg"
    path.write_bytes(jpeg_with_exif(np.zeros((40, 40, 3), np.uint8), exif(1, 0)))
    assert read_photograph(path).field_of_view == 50.0


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_linear_picture_is_exposed_for_a_display_or_as_told(tmp_path, rng, suffix):
    radiance = (50.0 * rng.random((40, 50, 3)) ** 4).astype(np.float32)
    path = tmp_path / f"linear{suffix}"
    write_image(path, radiance)
    bright = np.percentile(read_photograph(path).radiance.max(axis=2), 95)
    assert bright == pytest.approx(0.9, rel=1e-3)
    as_stored = read_photograph(path, exposure=0.0).radiance
    coarse = 0.3 if suffix == ".hdr" else 0.0  # one exponent for three channels
    np.testing.assert_allclose(as_stored, radiance, rtol=0.02, atol=coarse)
    np.testing.assert_allclose(read_photograph(path, exposure=1.0).radiance, 2 * as_stored)


def test_black_picture_is_not_exposed():
    black = np.zeros((4, 4, 3), np.float32)
    np.testing.assert_array_equal(expose(black), black)


def test_negative_light_is_none_and_nan_is_refused(tmp_path):
    radiance = np.full((40, 40, 3), 0.5, np.float32)
    radiance[0, 0] = -0.1
    write_image(tmp_path / "p.exr", radiance)
    assert read_photograph(tmp_path / "p.exr").radiance.min() == 0.0
    radiance[0, 0] = np.nan
    write_image(tmp_path / "p.exr", radiance)
    with pytest.raises(NonFiniteError, match=r"p\.exr: 3 of 4800 values are NaN"):
        read_photograph(tmp_path / "p.exr")


def test_too_small_too_deep_or_missing(tmp_path):
    write_image(tmp_path / "dot.png", np.zeros((8, 40, 3), np.float32))
    with pytest.raises(ShapeError, match=r"at least 32×32 pixels, got 40×8"):
        read_photograph(tmp_path / "dot.png")
    with pytest.raises(ImageFileError, match="cannot be read"):
        read_photograph(tmp_path / "none.jpg")


def direction_panorama(height=256):
    """A panorama whose colour is the direction it is seen in: right, up, away, as 0.5 + 0.5·d."""
    latitude = (0.5 - (np.arange(height) + 0.5) / height) * np.pi
    longitude = ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5) * 2 * np.pi
    latitude, longitude = latitude[:, None], longitude[None, :]
    right = np.cos(latitude) * np.sin(longitude)
    away = np.cos(latitude) * np.cos(longitude)
    up = np.broadcast_to(np.sin(latitude), right.shape)
    return Photograph((0.5 + 0.5 * np.stack([right, up, away], -1)).astype(np.float32))


@pytest.mark.parametrize(
    ("yaw", "pitch", "fov"),
    [(0, 0, 50), (90, 0, 50), (-170, -30, 70), (180, 60, 40), (10, -85, 90)],
)
def test_view_of_a_panorama_looks_where_it_is_told(yaw, pitch, fov):
    camera = Camera(64, 48, fov)
    view = crop_panorama(direction_panorama(), yaw, pitch, camera)
    assert view.field_of_view == fov
    rays = camera.rays().astype(np.float64)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    p, y = math.radians(pitch), math.radians(yaw)
    up = math.cos(p) * rays[..., 1] - math.sin(p) * rays[..., 2]
    ahead = math.sin(p) * -rays[..., 1] + math.cos(p) * -rays[..., 2]
    right = rays[..., 0] * math.cos(y) + ahead * math.sin(y)
    away = -rays[..., 0] * math.sin(y) + ahead * math.cos(y)
    wanted = 0.5 + 0.5 * np.stack([right, up, away], -1)
    np.testing.assert_allclose(view.radiance, wanted, atol=0.01)


def test_horizon_of_a_view_is_where_the_panorama_has_it():
    camera = Camera(80, 120, 60)
    view = crop_panorama(direction_panorama(), 25, -12, camera)
    column = view.radiance[:, 40, 1]  # 0.5 on the horizon, falling downwards
    row = np.interp(-0.5, -column, np.arange(120) + 0.5)
    assert row / 120 == pytest.approx(horizon_of(camera, -12), abs=0.005)


def test_a_lamp_leaves_no_dark_ring():
    panorama = np.full((64, 128, 3), 0.2, np.float32)
    panorama[30:34, 60:64] = 5000.0
    view = crop_panorama(Photograph(panorama), 0, 0, Camera(64, 64, 60))
    assert view.radiance.min() > 0.05


def test_what_is_no_panorama_is_said():
    with pytest.raises(ShapeError, match=r"twice as wide as high, got 60×40"):
        crop_panorama(Photograph(np.zeros((40, 60, 3), np.float32)), 0, 0, Camera(32, 32))
    with pytest.raises(InvalidInputError, match="pitch"):
        crop_panorama(direction_panorama(32), 0, 120, Camera(32, 32))
