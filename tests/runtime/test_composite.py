"""From predictions to the picture: the background is kept, the shadow only darkens."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from spotlight_runtime.diffusion.conditioning import dilate
from spotlight_runtime.relighting.composite import (
    colour_balance,
    compose_picture,
    limit_to_region,
    shadow_ratio,
)

PIXELS = st.floats(0.0, 1.0, width=32)
PICTURES = arrays.arrays(np.float32, (6, 7, 3), elements=PIXELS)
MASKS = arrays.arrays(np.float32, (6, 7), elements=PIXELS)


@given(PICTURES, PICTURES)
def test_ratio_only_darkens(predicted, no_shadow):
    ratio = shadow_ratio(predicted, no_shadow)
    assert ratio.shape == (6, 7)
    assert ratio.dtype == np.float32
    assert (ratio >= 0.0).all()
    assert (ratio <= 1.0).all()


def test_ratio_by_hand():
    grey = np.full((1, 3, 3), 0.5, np.float32)
    shaded = np.float32([0.25, 0.5, 0.75])[None, :, None] * np.ones((1, 3, 3), np.float32)
    np.testing.assert_allclose(shadow_ratio(shaded, grey), [[0.5, 1.0, 1.0]], atol=1e-5)
    red, blue = np.zeros((2, 1, 1, 3), np.float32)
    red[..., 0] = blue[..., 2] = 1.0
    assert shadow_ratio(blue, red)[0, 0] == pytest.approx(0.114 / 0.299, rel=1e-4)


def test_ratio_of_black_is_one():
    black = np.zeros((2, 2, 3), np.float32)
    assert (shadow_ratio(black, black) == 1.0).all()
    assert (shadow_ratio(black + 1, black) == 1.0).all()


def test_region_is_soft_at_its_border_and_exact_beyond():
    region = np.zeros((41, 41), bool)
    region[18:23, 18:23] = True
    limited = limit_to_region(np.full((41, 41), 0.5, np.float32), region)
    beyond = np.ones((41, 41), bool)
    beyond[11:30, 11:30] = False
    assert (limited[beyond] == 1.0).all()
    assert limited[20, 20] == pytest.approx(0.5, abs=0.1)
    assert 0.55 < limited[20, 23] < 0.95
    assert np.all(np.diff(limited[20, 20:]) >= 0.0)


@pytest.mark.parametrize("value", [True, False])
def test_region_everywhere_or_nowhere(value, rng):
    ratio = rng.random((20, 20), dtype=np.float32)
    limited = limit_to_region(ratio, np.full((20, 20), value))
    np.testing.assert_allclose(limited, ratio if value else 1.0, atol=1e-6)


@given(PICTURES, st.floats(0.25, 4.0), st.floats(0.25, 4.0))
def test_balance_finds_a_colour_cast_outside_the_object(picture, red, blue):
    no_shadow = 0.05 + 0.2 * picture
    cast = np.float32([red, 1.0, blue])
    mask = np.zeros((6, 7), np.float32)
    mask[2:4, 2:4] = 1.0
    background = no_shadow * cast
    background[2:4, 2:4] = 99.0
    got = colour_balance(background, no_shadow, mask)
    np.testing.assert_allclose(got, cast, rtol=1e-4)
    assert got.dtype == np.float32


def test_balance_counts_half_covered_pixels_half():
    background = np.float32([[[1.0] * 3, [3.0] * 3]])
    mask = np.float32([[0.0, 0.5]])
    got = colour_balance(background, np.ones_like(background), mask)
    np.testing.assert_allclose(got, (1.0 + 0.5 * 3.0) / 1.5, rtol=1e-6)


@pytest.mark.parametrize("case", ["object everywhere", "black prediction", "nearly black"])
def test_balance_of_nothing_is_one(case):
    background = np.full((4, 4, 3), 0.5, np.float32)
    no_shadow = np.full((4, 4, 3), 0.5, np.float32)
    mask = np.zeros((4, 4), np.float32)
    if case == "object everywhere":
        mask[:] = 1.0
    else:
        no_shadow[:] = 0.0 if case == "black prediction" else 9e-5
    np.testing.assert_array_equal(colour_balance(background, no_shadow, mask), np.ones(3))


def test_one_black_channel_leaves_the_others_balanced():
    background = np.full((4, 4, 3), 0.5, np.float32)
    no_shadow = np.full((4, 4, 3), 0.25, np.float32)
    no_shadow[..., 1] = 0.0
    got = colour_balance(background, no_shadow, np.zeros((4, 4), np.float32))
    np.testing.assert_allclose(got, [2.0, 1.0, 2.0])


@given(PICTURES, PICTURES, PICTURES, MASKS, st.booleans())
def test_picture_is_in_range_and_untouched_where_it_says_so(
    background, predicted, no_shadow, mask, limited
):
    region = mask > 0.7 if limited else None
    image, untouched = compose_picture(background, predicted, no_shadow, mask, region)
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    assert image.min() >= 0.0
    assert image.max() <= 1.0
    assert image[untouched].tobytes() == background[untouched].tobytes()
    assert not (untouched & (dilate(mask) > 0)).any()


@given(PICTURES, PICTURES, PICTURES, MASKS)
def test_background_is_never_brightened(background, predicted, no_shadow, mask):
    mask = np.where(mask > 0.5, mask, 0.0).astype(np.float32)
    image, _ = compose_picture(background, predicted, no_shadow, mask, None)
    outside = dilate(mask) == 0.0
    assert (image[outside] <= background[outside]).all()


def test_picture_by_hand():
    """One object pixel in the corner; its dilation takes the prediction, balanced."""
    background = np.full((8, 8, 3), 0.4, np.float32)
    no_shadow = np.full((8, 8, 3), 0.2, np.float32)
    predicted = no_shadow.copy()
    predicted[:3, :3] = 0.3
    predicted[6, 6] = 0.05
    mask = np.zeros((8, 8), np.float32)
    mask[0, 0] = 1.0
    image, untouched = compose_picture(background, predicted, no_shadow, mask, None)
    np.testing.assert_allclose(image[:2, :2], 0.6, atol=1e-5)
    np.testing.assert_allclose(image[6, 6], 0.1, atol=1e-5)
    assert (image[untouched] == np.float32(0.4)).all()
    assert untouched.sum() == 64 - 4 - 1


@pytest.mark.parametrize("size", [(1, 1), (1, 20), (20, 1), (3, 3)])
def test_slivers_are_composed_too(size):
    grey = np.full((*size, 3), 0.5, np.float32)
    mask = np.zeros(size, np.float32)
    image, untouched = compose_picture(grey, grey, grey, mask, mask > 0)
    np.testing.assert_array_equal(image, grey)
    assert untouched.all()


def test_empty_mask_and_full_mask(rng):
    background, predicted, no_shadow = rng.random((3, 6, 7, 3), dtype=np.float32)
    full = np.ones((6, 7), np.float32)
    image, untouched = compose_picture(background, predicted, no_shadow, full, None)
    np.testing.assert_array_equal(image, predicted)
    assert not untouched.any()
