"""Drawings cleaned into guiding shadows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_runtime.errors import InvalidInputError, NonFiniteError, ShapeError
from spotlight_runtime.shadows.scribble import clean_scribble

MASK = np.zeros((48, 64), np.float32)
MASK[10:30, 25:40] = 1.0


def stroke(height=48, width=64, paper=0.0, ink=1.0):
    """A horizontal stroke over three quarters of the picture, below its middle."""
    drawing = np.full((height, width), paper, np.float32)
    drawing[height // 2 : height * 3 // 4, width // 8 : width * 7 // 8] = ink
    return drawing


def test_a_clean_drawing_stays_as_it_is_but_for_the_object():
    np.testing.assert_array_equal(clean_scribble(stroke(), MASK), stroke() * (1 - MASK))


@given(
    st.integers(8, 200), st.integers(8, 200), st.sampled_from([0, 1, 2, 3, 4]), st.floats(0.05, 1)
)
def test_any_size_channels_and_strength(height, width, channels, ink):
    drawing = stroke(height, width, ink=ink)
    if channels:
        drawing = np.repeat(drawing[..., None], channels, axis=2)
        if channels in (2, 4):
            drawing[..., -1] = 1.0
    shadow = clean_scribble(drawing, MASK)
    assert shadow.dtype == np.float32
    assert shadow.shape == MASK.shape
    assert shadow.min() >= 0.0
    assert shadow.max() == pytest.approx(1.0, abs=1e-5)
    assert not shadow[MASK == 1.0].any()
    wanted = stroke() * (1 - MASK)
    assert np.abs(shadow - wanted).mean() < 0.12


def test_a_drawing_on_nothing_counts_by_its_alpha():
    drawing = np.ones((48, 64, 4), np.float32)
    drawing[..., 3] = stroke()
    np.testing.assert_allclose(clean_scribble(drawing, MASK), stroke() * (1 - MASK), atol=1e-6)


def test_grain_on_the_paper_goes_and_half_tones_stay():
    rng = np.random.default_rng(0)
    drawing = stroke(paper=0.1, ink=0.9)
    drawing[4:8] = 0.5
    noisy = drawing + rng.uniform(-0.02, 0.02, drawing.shape).astype(np.float32)
    shadow = clean_scribble(noisy, np.zeros_like(MASK))
    assert not shadow[12:20].any()
    assert 0.4 < shadow[4:8].mean() < 0.55
    assert shadow[26:34, 12:50].min() > 0.9


def test_softness_is_the_width_of_the_edge():
    drawing = np.zeros((40, 200), np.float32)
    drawing[:, 100:] = 1.0
    for softness in (4.0, 20.0):
        row = clean_scribble(drawing, np.zeros_like(drawing), softness=softness)[20]
        climbing = ((row > 0.1) & (row < 0.9)).sum()
        assert climbing == pytest.approx(softness, abs=1.5)
        assert row[100:].mean() > 0.9


def test_softness_does_not_soften_the_object_s_edge():
    shadow = clean_scribble(
        np.pad(np.ones((20, 64), np.float32), ((28, 0), (0, 0))), MASK, softness=9
    )
    assert not shadow[MASK == 1.0].any()
    assert shadow[29, 41] > 0.4  # right beside the object


def test_black_on_white_is_asked_about_and_can_be_inverted():
    drawing = stroke(paper=1.0, ink=0.0)
    with pytest.raises(InvalidInputError, match="--invert"):
        clean_scribble(drawing, MASK)
    np.testing.assert_array_equal(clean_scribble(drawing, MASK, invert=True), stroke() * (1 - MASK))


@pytest.mark.parametrize(
    ("drawing", "error", "named"),
    [
        (np.zeros((48, 64), np.float32), InvalidInputError, "nothing that stands out"),
        (np.full((48, 64), 0.3, np.float32), InvalidInputError, "nothing that stands out"),
        (MASK, InvalidInputError, "under the object alone"),
        (np.full((48, 64), np.nan, np.float32), NonFiniteError, "NaN"),
        (np.zeros((0, 4), np.float32), ShapeError, "shape"),
        (np.zeros(9, np.float32), ShapeError, "shape"),
        (np.zeros((4, 4, 5), np.float32), ShapeError, "at most 4 channels"),
    ],
)
def test_what_is_no_drawing_is_said(drawing, error, named):
    with pytest.raises(error, match=named):
        clean_scribble(drawing, MASK)


@pytest.mark.parametrize("softness", [-1.0, float("nan"), float("inf")])
def test_impossible_softness(softness):
    with pytest.raises(InvalidInputError, match="softness"):
        clean_scribble(stroke(), MASK, softness=softness)
