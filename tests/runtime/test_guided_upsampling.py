"""Small pictures brought to the size of a guide they follow."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_runtime.imaging.upsampling import fit_guided, magnify_rows
from spotlight_runtime.relighting.window import shrink


def fitted(values, weights, guide, **extra):
    slopes = guide.shape[-1]
    ridge, usual = (*[1e-2] * slopes, 0.0), (*[0.0] * slopes, extra.pop("usual", 1.0))
    return fit_guided(values, weights, guide, ridge=ridge, usual=usual, **extra)


def evaluated(fit, guide, cover=None):
    size = guide.shape[:2]
    cover = np.ones(size, np.float32) if cover is None else cover
    return fit.rows(guide, 0, size[0], size, cover)


@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 40), st.integers(1, 40), st.data())
def test_magnification_is_opencvs(height, width, taller, wider, data):
    small = np.random.default_rng(height).random((height, width, 3)).astype(np.float32)
    size = (max(height, taller), max(width, wider))
    whole = cv2.resize(small, size[::-1], interpolation=cv2.INTER_LINEAR)
    top = data.draw(st.integers(0, size[0] - 1))
    bottom = data.draw(st.integers(top + 1, size[0]))
    rows = magnify_rows(small, top, bottom, size)
    np.testing.assert_allclose(rows, whole.reshape(*size, 3)[top:bottom], atol=1e-5)


def test_magnification_takes_single_planes():
    small = np.arange(6, dtype=np.float32).reshape(2, 3)
    np.testing.assert_allclose(
        magnify_rows(small, 0, 4, (4, 6)), cv2.resize(small, (6, 4)), atol=1e-6
    )


@pytest.fixture
def guide(rng):
    """Two planes with sharp edges at full resolution."""
    rows, columns = np.mgrid[:96, :96]
    edge = (rows + columns > 96).astype(np.float32)
    wave = np.sin(columns / 9.0).astype(np.float32)
    return np.stack([edge, wave], axis=-1)


def small_of(array, scale=8):
    return shrink(array, (array.shape[0] // scale, array.shape[1] // scale))


def test_what_is_linear_in_the_guide_comes_back_sharp(guide):
    truth = 0.2 + 0.5 * guide[..., 0] - 0.1 * guide[..., 1]
    fit = fitted(small_of(truth), np.ones((12, 12), np.float32), small_of(guide))
    guided = np.abs(evaluated(fit, guide) - truth)
    plain = np.abs(cv2.resize(small_of(truth), (96, 96)) - truth)
    assert guided.max() < 0.05
    assert plain.max() > 0.2
    assert guided.mean() < 0.2 * plain.mean()


def test_what_the_guide_knows_nothing_of_is_only_smoothed(guide):
    blob = np.zeros((12, 12), np.float32)
    blob[5:8, 5:8] = 1.0
    fit = fitted(blob, np.ones_like(blob), np.zeros((12, 12, 1), np.float32))
    back = evaluated(fit, np.zeros((96, 96, 1), np.float32))
    assert back[52, 52] > 0.85
    assert np.abs(back[:16]).max() < 0.02


def test_holes_are_filled_from_around():
    values = np.full((20, 20), 0.7, np.float32)
    values[8:12, 8:12] = 99.0
    weights = np.ones_like(values)
    weights[8:12, 8:12] = 0.0
    fit = fitted(values, weights, np.zeros((20, 20, 0), np.float32))
    np.testing.assert_allclose(fit.coefficients[..., -1], 0.7, atol=1e-4)


def test_far_inside_a_hole_the_usual_decides():
    values = np.full((64, 64), 5.0, np.float32)
    values[:4] = 0.3
    weights = np.zeros_like(values)
    weights[:4] = 1.0
    fit = fitted(values, weights, np.zeros((64, 64, 0), np.float32), usual=0.4)
    assert fit.coefficients[2, 32, -1] == pytest.approx(0.3, abs=1e-3)
    assert fit.coefficients[40, 32, -1] == pytest.approx(0.4, abs=1e-3)


def test_nothing_known_at_all_is_one():
    """A ratio or a shading of one changes nothing."""
    zeros = np.zeros((6, 6), np.float32)
    fit = fitted(zeros, zeros, zeros[..., None])
    np.testing.assert_allclose(fit.coefficients, np.broadcast_to([0.0, 1.0], (6, 6, 2)), atol=1e-5)


def test_premultiplied_guides_give_premultiplied_results(guide, rng):
    fit = fitted(rng.random((12, 12)), np.ones((12, 12)), small_of(guide))
    cover = rng.random((96, 96)).astype(np.float32)
    got = evaluated(fit, guide * cover[..., None], cover)
    np.testing.assert_allclose(got, cover * evaluated(fit, guide), atol=1e-5)


def test_rows_do_not_depend_on_the_strip_they_come_in(guide, rng):
    fit = fitted(rng.random((12, 12)), np.ones((12, 12)), small_of(guide))
    ones = np.ones((96, 96), np.float32)
    whole = evaluated(fit, guide)
    strips = [
        fit.rows(guide[a:b], a, b, (96, 96), ones[a:b]) for a, b in ((0, 7), (7, 50), (50, 96))
    ]
    np.testing.assert_array_equal(np.concatenate(strips), whole)


def test_what_is_left_over_goes_where_it_is_sent(rng):
    """All of it to the slope: where the guide is dark, so is what comes back."""
    values = rng.random((12, 12)).astype(np.float32)
    guide = np.full((12, 12, 1), 0.5, np.float32)
    leftover = np.stack([1.0 / guide[..., 0], np.zeros((12, 12))], axis=-1)
    fit = fitted(values, np.ones_like(values), guide, leftover=leftover)
    assert fit.coefficients[..., 0].std() > 0.1
    plain = fitted(values, np.ones_like(values), guide)
    assert fit.coefficients[..., 1].std() < plain.coefficients[..., 1].std()
    ones = np.ones((12, 12), np.float32)
    np.testing.assert_allclose(
        fit.rows(guide, 0, 12, (12, 12), ones), plain.rows(guide, 0, 12, (12, 12), ones), atol=1e-5
    )
