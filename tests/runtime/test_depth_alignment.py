"""Putting the object's depth into the background's units."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_runtime.diffusion.conditioning import align_depth

SIZE = (6, 8)
FULL = np.ones(SIZE, np.float32)


def plane(low, high):
    return np.linspace(low, high, 48, dtype=np.float32).reshape(SIZE)


@given(st.floats(0.01, 100.0), st.floats(-5.0, 5.0))
def test_footprint_recovers_scale_and_offset(m, c):
    foot = plane(1.0, 3.0)
    background = (m * foot.astype(np.float64) + c).astype(np.float32)
    got_m, got_c = align_depth(foot, FULL, background, foot)
    assert got_m == pytest.approx(m, rel=1e-3)
    np.testing.assert_allclose(got_m * foot + got_c, background, rtol=1e-4, atol=1e-4 * (m + 5))


def test_fit_is_least_squares(rng):
    foot = plane(1.0, 3.0)
    background = (2.0 * foot + 1.0 + 0.1 * rng.standard_normal(SIZE)).astype(np.float32)
    m, c = align_depth(foot, FULL, background, foot)
    wanted = np.polyfit(foot.ravel().astype(np.float64), background.ravel().astype(np.float64), 1)
    np.testing.assert_allclose([m, c], wanted, rtol=1e-6)


def test_only_the_footprint_counts():
    foot = np.zeros(SIZE, np.float32)
    foot[4, 2:6] = [1.0, 1.5, 2.0, 2.5]
    background = 100.0 * FULL
    background[4, 2:6] = [3.0, 4.0, 5.0, 6.0]
    m, c = align_depth(plane(9.0, 1.0), FULL, background, foot)
    assert (m, c) == (pytest.approx(2.0), pytest.approx(1.0))


@pytest.mark.parametrize("case", ["one pixel", "constant", "rounding"])
def test_footprint_without_a_slope_is_shifted(case):
    foot = np.zeros(SIZE, np.float32)
    if case == "one pixel":
        foot[2, 3] = 2.0
    else:
        foot[2, :] = 2.0
    if case == "rounding":
        foot[2, ::2] = np.nextafter(np.float32(2.0), np.float32(3.0))
    m, c = align_depth(foot, FULL, plane(5.0, 5.0), foot)
    assert m == 1.0
    assert c == pytest.approx(3.0, abs=1e-6)


def test_background_that_slopes_the_other_way_is_not_mirrored():
    foot = plane(1.0, 3.0)
    m, c = align_depth(foot, FULL, 10.0 - foot, foot)
    assert m == 1.0
    assert c == pytest.approx(6.0, abs=1e-5)


def test_flat_background_is_no_slope_either():
    foot = plane(1.0, 3.0)
    m, c = align_depth(foot, FULL, 4.0 * FULL, foot)
    assert m == 1.0
    assert c == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize("footprint", [None, np.zeros(SIZE, np.float32)])
def test_without_footprint_nearest_meets_nearest(footprint):
    mask = np.zeros(SIZE, np.float32)
    mask[1:4, 2:6] = 1.0
    m, c = align_depth(mask * plane(5.0, 9.0), mask, plane(2.0, 4.0), footprint)
    nearest = plane(5.0, 9.0)[mask > 0].min()
    assert m == 1.0
    assert nearest + c == pytest.approx(plane(2.0, 4.0)[mask > 0].min(), abs=1e-6)


def test_without_footprint_depth_is_unpremultiplied():
    mask = 0.6 * FULL
    m, c = align_depth(mask * plane(5.0, 9.0), mask, plane(2.0, 4.0))
    assert m == 1.0
    assert c == pytest.approx(2.0 - 5.0, abs=1e-5)


def test_thin_edges_of_the_object_do_not_decide():
    """Dividing by a coverage near 0 says little; covered pixels decide where there are any."""
    mask = np.zeros(SIZE, np.float32)
    mask[2, 2:5] = 1.0
    depth = mask * 5.0
    mask[2, 5], depth[2, 5] = 0.01, 0.0001
    assert align_depth(depth, mask, plane(2.0, 2.0))[1] == pytest.approx(-3.0)


def test_object_of_thin_edges_only_is_still_aligned():
    mask = 0.2 * FULL
    assert align_depth(mask * 5.0, mask, 2.0 * FULL) == (1.0, pytest.approx(-3.0))


def test_no_object_needs_no_alignment():
    nothing = np.zeros(SIZE, np.float32)
    assert align_depth(nothing, nothing, plane(2.0, 4.0)) == (1.0, 0.0)
