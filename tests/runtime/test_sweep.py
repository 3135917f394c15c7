"""Contact sheets and animations of lights all round."""

import importlib.util

import cv2
import numpy as np
import pytest

from spotlight_runtime.errors import InvalidInputError, MissingExtraError
from spotlight_runtime.relighting.sweep import (
    CAPTION,
    GAP,
    TILE_SIDE,
    check_animation,
    contact_sheet,
    make_tile,
    ring,
    write_animation,
)


def test_ring_goes_round_evenly():
    lights = ring(8, 30.0, 0.5, None)
    assert [light.azimuth for light in lights] == [0, 45, 90, 135, 180, 225, 270, 315]
    assert {(light.elevation, light.radius, light.distance) for light in lights} == {
        (30.0, 0.5, None)
    }
    with pytest.raises(InvalidInputError, match="sweep: expected at least one light, got 0"):
        ring(0)


@pytest.fixture
def tile(rng):
    image = rng.random((300, 400, 3), np.float32) * 0.5
    shadow = np.zeros((300, 400), np.float32)
    shadow[150:, :200] = 1.0
    mask = np.zeros((300, 400), np.float32)
    mask[:, 350:] = 1.0
    return make_tile(image, shadow, mask, "azimuth 45°"), image


def test_tile_is_the_picture_with_its_shadow_in_the_corner(tile):
    made, image = tile
    assert made.picture.shape == (300, 400, 3)
    np.testing.assert_array_equal(made.picture[100:], image[100:])
    inset = made.picture[:89, 281:]
    np.testing.assert_allclose(inset[5, 5], 1.0)  # ground
    np.testing.assert_allclose(inset[80, 5], 0.0)  # shadow
    assert 0.3 < inset[80, -3, 0] < 0.8  # the object


def test_large_pictures_are_shrunk_to_the_sheet(rng):
    image = rng.random((600, 1500, 3), np.float32)
    plane = np.zeros((600, 1500), np.float32)
    made = make_tile(image, plane, plane, "")
    assert made.picture.shape == (round(600 * TILE_SIDE / 1500), TILE_SIDE, 3)


@pytest.mark.parametrize(("count", "rows", "columns"), [(1, 1, 1), (3, 1, 3), (8, 2, 4), (9, 3, 4)])
def test_sheet_has_up_to_four_in_a_row(tile, count, rows, columns):
    sheet = contact_sheet([tile[0]] * count)
    assert sheet.shape == (rows * (300 + CAPTION + GAP) + GAP, columns * (400 + GAP) + GAP, 3)
    np.testing.assert_array_equal(sheet[GAP : GAP + 300, GAP : GAP + 400], tile[0].picture)
    caption = sheet[GAP + 300 : GAP + 300 + CAPTION, GAP : GAP + 400]
    assert caption.min() < 0.3
    assert caption.max() == 1.0


@pytest.mark.parametrize("suffix", [".gif", ".webp", ".mp4"])
def test_animation_has_a_frame_a_picture(tmp_path, rng, suffix):
    pytest.importorskip("imageio", reason="animations need the extra `scene`")
    from PIL import Image

    path = tmp_path / f"turn{suffix}"
    pictures = [np.full((31, 41, 3), v, np.float32) for v in (0.1, 0.5, 0.9)]
    write_animation(path, pictures)
    if suffix == ".mp4":
        film = cv2.VideoCapture(str(path))
        frames = []
        while (frame := film.read())[0]:
            frames.append(frame[1])
        assert np.shape(frames) == (3, 30, 40, 3)  # even sides, as the codec wants them
        levels = np.mean(frames, axis=(1, 2, 3)) / 255
    else:
        with Image.open(path) as film:
            assert film.n_frames == 3
            assert film.size == (41, 31)
            levels = []
            for i in range(3):
                film.seek(i)
                levels.append(np.asarray(film.convert("RGB")).mean() / 255)
    np.testing.assert_allclose(levels, [0.1, 0.5, 0.9], atol=0.03)


def test_animation_that_cannot_be_written_is_said_first(tmp_path):
    with pytest.raises(InvalidInputError, match=r"turn\.avi: expected one of \.mp4, \.gif, \.webp"):
        check_animation(tmp_path / "turn.avi")
    with pytest.raises(InvalidInputError, match="there is no folder"):
        check_animation(tmp_path / "nowhere/turn.gif")


def test_missing_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install 'spotlight-relight\[scene\]'"):
        check_animation(tmp_path / "turn.mp4")
