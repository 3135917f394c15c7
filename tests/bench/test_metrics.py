"""Metrics against hand-computed values and against what the libraries call their score."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity

from spotlight_bench.metrics import (
    BEST_PSNR,
    METRICS,
    background_change,
    flip_map,
    isolated,
    regions,
    scores,
)

SIDE = 32


def images(seed=0, error=0.1):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.2, 0.8, (SIDE, SIDE, 3)).astype(np.float32)
    picture = np.clip(truth + error * rng.standard_normal(truth.shape), 0, 1)
    return picture.astype(np.float32), truth


def left_half():
    mask = np.zeros((SIDE, SIDE), np.float32)
    mask[:, : SIDE // 2] = 1.0
    return mask


def score(picture, truth, mask):
    masks = regions(mask)
    return scores(isolated(picture, truth, masks), truth, masks, {})


def similarity(beyond):
    """SSIM of 0.5 with 0.6 in a 7×7 window, of which so many columns are equal."""
    share = (7 - beyond) / 7
    mean, variance = 0.5 + 0.1 * share, 49 / 48 * 0.1**2 * share * (1 - share)
    luminance = (2 * 0.5 * mean + 0.01**2) / (0.5**2 + mean**2 + 0.01**2)
    return luminance * 0.03**2 / (variance + 0.03**2)


def test_a_constant_error_gives_the_figures_one_computes_by_hand():
    truth = np.full((SIDE, SIDE, 3), 0.5, np.float32)
    picture = truth + np.where(left_half() > 0, 0.1, 0.0)[..., None].astype(np.float32)
    found = score(picture, truth, left_half())
    assert found["foreground"]["psnr"] == pytest.approx(20.0, abs=1e-4)
    assert found["foreground"]["rmse"] == pytest.approx(0.1, abs=1e-6)
    assert found["foreground"]["mae"] == pytest.approx(0.1, abs=1e-6)
    assert found["full"]["psnr"] == pytest.approx(10 * np.log10(1 / 0.005), abs=1e-4)
    assert found["full"]["rmse"] == pytest.approx(0.005**0.5, abs=1e-6)
    assert found["full"]["mae"] == pytest.approx(0.05, abs=1e-6)
    assert found["background"]["psnr"] == BEST_PSNR
    assert found["background"]["mae"] == 0.0
    assert found["background"]["ssim"] == pytest.approx(1.0, abs=1e-6)
    assert found["background"]["flip"] == 0.0
    # Of the object's columns with whole 7×7 windows, ten see constant patches alone: luminance.
    seam = [similarity(beyond) for beyond in (1, 2, 3)]
    expected = np.mean([*[similarity(0)] * 10, *seam])
    assert found["foreground"]["ssim"] == pytest.approx(expected, abs=1e-4)


def test_whole_pictures_score_what_the_libraries_say():
    import flip_evaluator

    picture, truth = images()
    found = score(picture, truth, left_half())["full"]
    assert found["ssim"] == pytest.approx(
        structural_similarity(truth, picture, data_range=1.0, channel_axis=2), abs=1e-6
    )
    _, mean, _ = flip_evaluator.evaluate(truth, picture, "LDR", applyMagma=False)
    assert found["flip"] == pytest.approx(mean, abs=1e-6)
    assert flip_map(picture, truth).shape == (SIDE, SIDE)


@settings(max_examples=10)
@given(seed=st.integers(0, 99), split=st.integers(1, SIDE - 1))
def test_squared_errors_of_the_regions_make_up_the_whole(seed, split):
    picture, truth = images(seed)
    mask = np.zeros((SIDE, SIDE), np.float32)
    mask[:split] = 1.0
    found = score(picture, truth, mask)
    share = split / SIDE
    parts = (
        share * found["foreground"]["rmse"] ** 2 + (1 - share) * found["background"]["rmse"] ** 2
    )
    assert found["full"]["rmse"] ** 2 == pytest.approx(parts, rel=1e-6)


def test_a_region_is_scored_by_its_own_pixels_alone():
    picture, truth = images()
    other = picture.copy()
    other[:, SIDE // 2 :] = 0.0
    one, two = (score(p, truth, left_half()) for p in (picture, other))
    assert one["foreground"] == two["foreground"]
    for metric in METRICS:
        if metric.name != "st_lpips":
            worse = two["background"][metric.name] < one["background"][metric.name]
            assert worse == metric.higher_is_better


def test_an_object_that_covers_nothing_or_everything_leaves_a_region_without_figures():
    picture, truth = images()
    nothing = score(picture, truth, np.zeros((SIDE, SIDE), np.float32))
    assert set(nothing["foreground"].values()) == {None}
    assert nothing["background"] == nothing["full"]
    everything = score(picture, truth, np.ones((SIDE, SIDE), np.float32))
    assert set(everything["background"].values()) == {None}
    assert everything["foreground"] == everything["full"]


def test_half_covered_pixels_belong_to_the_object():
    masks = regions(np.array([[0.49, 0.5], [0.51, 0.0]], np.float32))
    np.testing.assert_array_equal(masks["foreground"], [[False, True], [True, False]])
    np.testing.assert_array_equal(masks["background"], ~masks["foreground"])


def test_background_change_looks_only_where_object_and_shadow_do_not_reach():
    photograph = np.full((64, 64, 3), 0.5, np.float32)
    mask, shadow = np.zeros((2, 64, 64), np.float32)
    mask[20:30, 20:30], shadow[30:36, 20:30] = 1.0, 1.0
    touched = photograph.copy()
    touched[20:36, 20:30] = 0.1
    assert background_change(touched, photograph, mask, shadow) == 0.0
    touched[60, 60] += 0.25
    assert background_change(touched, photograph, mask, shadow) == pytest.approx(0.25)
    assert background_change(touched, photograph, np.ones_like(mask), shadow) is None
