"""Where and how strongly the guiding shadow enters the latents."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from spotlight_runtime.diffusion.blending import (
    add_noise,
    blend_shadow,
    downsample_antialiased,
    downsample_bilinear,
    latent_shadow_mask,
    weight_of_steps,
)

UNIT = st.floats(0.0, 1.0, width=32)


def images(factor):
    sides = st.tuples(st.integers(1, 5), st.integers(1, 5))
    return sides.flatmap(
        lambda s: arrays.arrays(np.float32, (s[0] * factor, s[1] * factor), elements=UNIT)
    )


def bilinear_loop(image, factor):
    """Sample at latent centres, half-pixel convention, one output pixel at a time."""
    rows, columns = (side // factor for side in image.shape)
    out = np.zeros((rows, columns))
    for i in range(rows):
        for j in range(columns):
            y, x = (i + 0.5) * factor - 0.5, (j + 0.5) * factor - 0.5
            y0, x0 = int(np.floor(y)), int(np.floor(x))
            for yy, wy in ((y0, 1 - (y - y0)), (y0 + 1, y - y0)):
                for xx, wx in ((x0, 1 - (x - x0)), (x0 + 1, x - x0)):
                    if wy * wx:
                        out[i, j] += wy * wx * image[yy, xx]
    return out


def triangle_loop(image, factor):
    """Triangle filter of half-width ``factor`` around each latent centre, cut at the border."""
    rows, columns = (side // factor for side in image.shape)
    out = np.zeros((rows, columns))
    for i in range(rows):
        for j in range(columns):
            total = weight = 0.0
            for y in range(image.shape[0]):
                for x in range(image.shape[1]):
                    wy = max(0.0, 1 - abs(y + 0.5 - (i + 0.5) * factor) / factor)
                    wx = max(0.0, 1 - abs(x + 0.5 - (j + 0.5) * factor) / factor)
                    total += wy * wx * float(image[y, x])
                    weight += wy * wx
            out[i, j] = total / weight
    return out


@pytest.mark.parametrize("factor", [1, 2, 3, 4, 5, 8])
@given(data=st.data())
def test_bilinear_equals_the_loop(factor, data):
    image = data.draw(images(factor))
    got = downsample_bilinear(image, factor)
    np.testing.assert_allclose(got, bilinear_loop(image, factor), atol=1e-6)


@pytest.mark.parametrize("factor", [1, 2, 3, 8])
def test_antialiased_equals_the_loop(factor, rng):
    image = rng.random((3 * factor, 4 * factor), dtype=np.float32)
    got = downsample_antialiased(image, factor)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, triangle_loop(image, factor), atol=1e-6)


def test_antialiased_weights_by_hand():
    """Factor 2, inner latent: pixels at 1.5 0.5 0.5 1.5 from its centre weigh 1 3 3 1 eighths."""
    image = np.tile(np.float32([0, 8, 0, 0, 0, 0]), (2, 1))
    np.testing.assert_allclose(downsample_antialiased(image, 2)[0], [24 / 7, 1.0, 0.0], rtol=1e-6)


@pytest.mark.parametrize("down", [downsample_antialiased, downsample_bilinear])
@given(st.floats(0.0, 1.0, width=32), st.integers(1, 4), st.integers(1, 4))
def test_constant_images_stay(down, value, rows, columns):
    image = np.full((8 * rows, 8 * columns), value, np.float32)
    got = down(image, 8)
    np.testing.assert_allclose(got, np.full((rows, columns), value), atol=1e-6)


@given(images(8))
def test_antialiased_stays_within_the_range_of_its_input(image):
    got = downsample_antialiased(image, 8)
    assert got.min() >= image.min() - 1e-6
    assert got.max() <= image.max() + 1e-6


@given(images(8), images(8))
def test_mask_knows_three_values_and_never_the_object(shadow, covering):
    height, width = (min(a, b) for a, b in zip(shadow.shape, covering.shape))
    shadow, covering = shadow[:height, :width], covering[:height, :width]
    mask = latent_shadow_mask(shadow, covering, 8)
    assert mask.dtype == np.float32
    assert mask.shape == (height // 8, width // 8)
    assert set(np.unique(mask)) <= {0.0, 1.0, 2.0}
    assert not mask[downsample_bilinear(covering, 8) > 0.05].any()


def naive_mask(shadow, covered):
    """Method's steps 2 to 4 on latent-sized masks, pixel by pixel."""
    binary = shadow > 0.05
    height, width = binary.shape
    out = np.zeros(binary.shape)
    for i in range(height):
        for j in range(width):
            cross = [
                binary[y, x]
                for y, x in ((i, j), (i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1))
                if 0 <= y < height and 0 <= x < width
            ]
            dilated, eroded = any(cross), all(cross)
            out[i, j] = eroded + 2.0 * (dilated and not eroded)
            if covered[i, j] > 0.05:
                out[i, j] = 0.0
    return out


@given(arrays.arrays(np.float32, (6, 7), elements=UNIT), st.integers(0, 2**31))
def test_mask_equals_the_supplement_pixel_by_pixel(shadow, seed):
    covered = np.random.default_rng(seed).random((6, 7), dtype=np.float32) ** 4
    np.testing.assert_array_equal(
        latent_shadow_mask(shadow, covered, 1), naive_mask(shadow, covered)
    )


def test_edges_count_double_on_both_sides_of_the_border():
    shadow = np.zeros((7, 7), np.float32)
    shadow[2:5, 2:5] = 1.0
    mask = latent_shadow_mask(shadow, np.zeros_like(shadow), 1)
    assert mask[3].tolist() == [0, 2, 2, 1, 2, 2, 0]


def test_mask_of_no_shadow_and_of_all_shadow():
    empty = np.zeros((16, 24), np.float32)
    full = np.ones_like(empty)
    assert not latent_shadow_mask(empty, empty, 8).any()
    assert (latent_shadow_mask(full, empty, 8) == 1.0).all()
    assert not latent_shadow_mask(full, full, 8).any()


def test_threshold_is_exclusive():
    at = np.full((3, 3), 0.05, np.float32)
    above = np.nextafter(at, np.float32(1.0))
    nothing = np.zeros_like(at)
    assert (latent_shadow_mask(above, nothing, 1) == 1.0).all()
    full = np.ones_like(at)
    assert not latent_shadow_mask(full, above, 1).any()


def test_layout_in_memory_does_not_matter(rng):
    shadow, covering = rng.random((2, 16, 24), dtype=np.float32)
    wanted = latent_shadow_mask(shadow, covering, 8)
    fortran = latent_shadow_mask(np.asfortranarray(shadow), covering[::-1].copy()[::-1], 8)
    np.testing.assert_array_equal(fortran, wanted)
    np.testing.assert_allclose(
        downsample_antialiased(np.asfortranarray(shadow), 8), downsample_antialiased(shadow, 8)
    )


@given(st.floats(0.0, 1.0))
def test_noise_keeps_unit_variance(alpha_bar):
    clean, noise = np.float32([1.0, 0.0]), np.float32([0.0, 1.0])
    got = add_noise(clean, noise, alpha_bar)
    assert float((got.astype(np.float64) ** 2).sum()) == pytest.approx(1.0, abs=1e-6)
    assert got.dtype == np.float32


def test_noise_at_both_ends(rng):
    clean, noise = rng.standard_normal((2, 4), dtype=np.float32)
    np.testing.assert_array_equal(add_noise(clean, noise, 1.0), clean)
    np.testing.assert_array_equal(add_noise(clean, noise, 0.0), noise)


@pytest.mark.parametrize("beta", [0.0, 1e-6, 0.05, 0.5, 1.0])
@pytest.mark.parametrize("steps", [2, 3, 6, 20, 50, 1000])
def test_any_number_of_steps_puts_in_as_much_shadow(beta, steps):
    weight = weight_of_steps(beta, 20, steps)
    assert 0.0 <= weight <= 1.0
    left = (1.0 - weight) ** (steps - 1)
    assert left == pytest.approx((1.0 - beta) ** 19, abs=1e-12)
    assert weight_of_steps(beta, 20, 20) == beta


@pytest.mark.parametrize(("usual", "steps"), [(1, 1), (1, 9), (20, 1)])
def test_without_a_blend_there_is_nothing_to_keep(usual, steps):
    assert weight_of_steps(0.3, usual, steps) == 0.3


@given(st.floats(0.0, 1.0), st.sampled_from([0.0, 1.0, 2.0]))
def test_blend_is_eq_1(beta, weight):
    z, noised = np.float32([[[[2.0]]]]), np.float32([[[[-1.0]]]])
    mask = np.full((1, 1, 1, 1), weight, np.float32)
    share = min(1.0, beta * weight)
    got = blend_shadow(z, noised, mask, beta)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, (1.0 - share) * z + share * noised, atol=1e-6)


def test_blend_touches_only_the_shadow(rng):
    z, noised = rng.standard_normal((2, 2, 4, 3, 5), dtype=np.float32)
    mask = np.zeros((2, 1, 3, 5), np.float32)
    mask[0, 0, 1, 2] = 2.0
    changed = blend_shadow(z, noised, mask, 0.05) != z
    assert changed[0, :, 1, 2].all()
    assert changed.sum() == 4
