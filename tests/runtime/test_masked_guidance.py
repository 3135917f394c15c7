"""Eq. 2 on the object, and nothing off it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from spotlight_runtime.diffusion.guidance import masked_guidance, rescale_guidance

SHAPE = (1, 4, 3, 5)
VALUES = st.floats(-10.0, 10.0, width=32)


def fields(shape=SHAPE, values=VALUES):
    return arrays.arrays(np.float32, shape, elements=values)


@given(fields(), fields(), fields((1, 1, 3, 5), st.floats(0, 1, width=32)), st.floats(0.0, 20.0))
def test_equals_the_paper_written_naively(v_pos, v_neg, mask, gamma):
    got = masked_guidance(v_pos, v_neg, mask, gamma)
    p, n, m = (a.astype(np.float64) for a in (v_pos, v_neg, mask))
    wanted = (1.0 - m) * p + m * (n + gamma * (p - n))
    np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-3)
    assert got.dtype == np.float32


@pytest.mark.parametrize("garbage", [3e38, -3e38, 1e-45, -0.0, np.nan, np.inf])
def test_gamma_one_is_the_positive_branch_bit_for_bit(garbage, rng):
    v_pos = rng.standard_normal(SHAPE, dtype=np.float32)
    mask = np.ones((1, 1, 3, 5), np.float32)
    got = masked_guidance(v_pos, np.full(SHAPE, garbage, np.float32), mask, 1.0)
    assert got.tobytes() == v_pos.tobytes()


@pytest.mark.parametrize("gamma", [0.0, 3.0, 7.0, 20.0])
def test_off_the_object_nothing_is_guided(gamma, rng):
    v_pos, v_neg = rng.standard_normal((2, *SHAPE), dtype=np.float32)
    mask = np.zeros((1, 1, 3, 5), np.float32)
    mask[..., 1, 2] = 1.0
    got = masked_guidance(v_pos, v_neg, mask, gamma)
    outside = np.broadcast_to(mask == 0.0, SHAPE)
    np.testing.assert_array_equal(got[outside], v_pos[outside])
    assert not np.array_equal(got[~outside], v_pos[~outside])


def test_gamma_zero_on_the_object_is_the_negative_branch(rng):
    v_pos, v_neg = rng.standard_normal((2, *SHAPE), dtype=np.float32)
    got = masked_guidance(v_pos, v_neg, np.ones((1, 1, 3, 5), np.float32), 0.0)
    np.testing.assert_allclose(got, v_neg, atol=1e-6)


def test_equal_branches_need_no_guidance(rng):
    v = rng.standard_normal(SHAPE, dtype=np.float32)
    mask = rng.random((1, 1, 3, 5), dtype=np.float32)
    np.testing.assert_array_equal(masked_guidance(v, v.copy(), mask, 7.0), v)


def test_full_rescale_restores_the_deviation_on_the_object(rng):
    v_pos = rng.standard_normal(SHAPE)
    mask = np.full((1, 1, 3, 5), 0.3)
    mask[..., :2, :3] = 0.9
    guided = rng.standard_normal(SHAPE)
    got = rescale_guidance(guided, v_pos, mask, 1.0)
    inside = np.broadcast_to(mask > 0.5, SHAPE)
    assert got[inside].std() == pytest.approx(v_pos[inside].std(), rel=1e-12)
    np.testing.assert_allclose(got / guided, got[inside].std() / guided[inside].std())


def test_half_rescale_is_half_way(rng):
    v_pos = rng.standard_normal(SHAPE)
    mask = np.ones((1, 1, 3, 5))
    np.testing.assert_allclose(rescale_guidance(3.0 * v_pos, v_pos, mask, 0.5), 2.0 * v_pos)


def test_no_rescale_is_the_same_array(rng):
    guided = rng.standard_normal(SHAPE, dtype=np.float32)
    assert rescale_guidance(guided, guided, np.ones((1, 1, 3, 5), np.float32), 0.0) is guided


@pytest.mark.parametrize("case", ["empty mask", "constant prediction", "constant guided"])
def test_no_deviation_to_restore_changes_nothing(case, rng):
    guided, v_pos = rng.standard_normal((2, *SHAPE), dtype=np.float32)
    mask = np.ones((1, 1, 3, 5), np.float32)
    if case == "empty mask":
        mask[:] = 0.0
    elif case == "constant prediction":
        v_pos[:] = 0.25
    else:
        guided[:] = 0.25
    np.testing.assert_array_equal(rescale_guidance(guided, v_pos, mask, 1.0), guided)


def test_rescale_keeps_float32(rng):
    guided, v_pos = rng.standard_normal((2, *SHAPE), dtype=np.float32)
    mask = rng.random((1, 1, 3, 5), dtype=np.float32)
    assert rescale_guidance(guided, v_pos, mask, 0.7).dtype == np.float32
