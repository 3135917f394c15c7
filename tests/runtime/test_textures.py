"""Textures and materials against their formulas."""

import numpy as np
import pytest

from spotlight_runtime.composing.materials import Material, decode_texture, make_texture, shade
from spotlight_runtime.imaging.colour import srgb_to_linear

NO_BLUR = np.zeros(1, np.float32)


def look(texture, *points, texels=0.0):
    uv = np.float32(points)
    return texture.sample(uv, np.full(len(uv), texels, np.float32))


def test_texel_centres_are_the_texels(rng):
    pixels = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    texture = make_texture(pixels, colour=True)
    rows, columns = np.mgrid[:5, :7]
    uv = np.stack([(columns + 0.5) / 7, (rows + 0.5) / 5], -1).reshape(-1, 2).astype(np.float32)
    found = texture.sample(uv, np.zeros(35, np.float32)).reshape(5, 7, 3)
    np.testing.assert_allclose(found, srgb_to_linear(pixels / np.float32(255)), atol=2e-4)


def test_data_is_not_decoded_and_alpha_never_is():
    pixels = np.full((2, 2, 4), 128, np.uint8)
    np.testing.assert_allclose(
        look(make_texture(pixels, colour=False), (0.5, 0.5)), 128 / 255, atol=1e-4
    )
    coloured = look(make_texture(pixels, colour=True), (0.5, 0.5))[0]
    assert coloured[3] == pytest.approx(128 / 255, abs=1e-4)
    assert coloured[0] == pytest.approx(float(srgb_to_linear(np.float32(128 / 255))), abs=1e-4)


def test_sixteen_bits_keep_their_steps():
    pixels = np.uint16([[[1000] * 3, [1010] * 3]])
    found = look(make_texture(pixels, colour=False), (0.25, 0.5), (0.75, 0.5))
    np.testing.assert_allclose(found[:, 0] * 65535, [1000, 1010], atol=0.6)


RAMP = np.repeat(np.uint8([[[0], [100], [200], [255]]]), 3, axis=2)


@pytest.mark.parametrize(
    ("wrap", "u", "wanted"),
    [
        ("repeat", 1.125, 0),
        ("repeat", -0.125, 255),
        ("repeat", 7.625, 200),
        ("repeat", 0.0, 127.5),
        ("clamp", 1.4, 255),
        ("clamp", -3.0, 0),
        ("mirror", 1.125, 255),
        ("mirror", -0.375, 100),
        ("mirror", 2.375, 100),
        ("mirror", 0.0, 0),
    ],
)
def test_wrapping(wrap, u, wanted):
    texture = make_texture(RAMP, colour=False, wrap=(wrap, "repeat"))
    assert look(texture, (u, 0.5))[0, 0] * 255 == pytest.approx(wanted, abs=0.5)
    upright = make_texture(RAMP.transpose(1, 0, 2), colour=False, wrap=("repeat", wrap))
    assert look(upright, (0.5, u))[0, 0] * 255 == pytest.approx(wanted, abs=0.5)


def test_a_pixel_that_covers_the_texture_sees_its_mean(rng):
    pixels = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    texture = make_texture(pixels, colour=True)
    mean = srgb_to_linear(pixels / np.float32(255)).mean(axis=(0, 1))
    np.testing.assert_allclose(look(texture, (0.3, 0.8), texels=1.0)[0], mean, atol=0.01)
    np.testing.assert_allclose(look(texture, (0.3, 0.8), texels=50.0)[0], mean, atol=0.01)


def test_levels_are_chosen_point_by_point():
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:, ::2] = 255
    texture = make_texture(pixels, colour=False)
    uv = np.float32([[0.5 / 64, 0.5], [0.5 / 64, 0.5]])
    sharp, blurred = texture.sample(uv, np.float32([0.0, 0.5]))[:, 0]
    assert sharp == pytest.approx(1.0, abs=1e-3)
    assert blurred == pytest.approx(0.5, abs=0.01)


def test_transform_and_second_coordinates(rng):
    pixels = rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)
    turn = np.float32([[0.0, 1.0, 0.25], [-1.0, 0.0, 0.5]])
    texture = make_texture(pixels, colour=False, transform=turn, uv_set=1)
    plain = make_texture(pixels, colour=False)
    u, v = 0.3, 0.9
    np.testing.assert_allclose(look(texture, (u, v)), look(plain, (v + 0.25, 0.5 - u)), atol=1e-4)
    material = Material(base_texture=texture, base_colour=(1, 1, 1, 1))
    assert material.uv_sets == {1}
    coordinates = {1: np.float32([[u, v]])}
    seen = shade(material, 1, coordinates, {1: NO_BLUR}, None)
    np.testing.assert_allclose(seen.albedo, look(texture, (u, v)), atol=1e-6)


def test_factors_multiply_textures_and_vertex_colours():
    grey = make_texture(np.full((2, 2, 4), 128, np.uint8), colour=False)
    material = Material(
        base_colour=(0.5, 1.0, 1.0, 0.5),
        roughness=0.5,
        metallic=0.25,
        base_texture=grey,
        surface_texture=grey,
        alpha="blend",
    )
    uv = {0: np.float32([[0.5, 0.5]])}
    colours = np.float32([[1.0, 0.5, 0.25, 0.5]])
    seen = shade(material, 1, uv, {0: NO_BLUR}, colours)
    half = 128 / 255
    np.testing.assert_allclose(seen.albedo[0], [0.5 * half, 0.5 * half, 0.25 * half], atol=1e-3)
    assert seen.alpha[0] == pytest.approx(0.25 * half, abs=1e-3)
    assert seen.roughness[0] == pytest.approx(0.5 * half, abs=1e-3)
    assert seen.metallic[0] == pytest.approx(0.25 * half, abs=1e-3)
    assert seen.bump is None


@pytest.mark.parametrize(("alpha", "wanted"), [(0.49, 0.0), (0.5, 1.0), (1.0, 1.0)])
def test_masked_surface_is_there_or_not(alpha, wanted):
    material = Material(base_colour=(1, 1, 1, alpha), alpha="mask")
    assert shade(material, 1, {}, {}, None).alpha[0] == wanted
    opaque = Material(base_colour=(1, 1, 1, alpha))
    assert shade(opaque, 1, {}, {}, None).alpha[0] == 1.0


def test_large_grey_and_two_channel_images(tmp_path):
    import cv2

    data = cv2.imencode(".png", np.full((8, 5000), 77, np.uint8))[1].tobytes()
    pixels = decode_texture(data, "wide.png")
    assert pixels.shape[1] <= 2048
    assert pixels.shape[2] == 3
    assert (pixels == 77).all()
