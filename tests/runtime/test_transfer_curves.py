"""Transfer curves between linear light and pixels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from spotlight_runtime.imaging.colour import (
    decode_to_linear,
    encode_linear,
    gamma22_to_linear,
    linear_to_gamma22,
    linear_to_srgb,
    luma,
    srgb_to_linear,
)

RAMP = np.linspace(0.0, 1.0, 100_001, dtype=np.float32)
CURVES = [linear_to_gamma22, gamma22_to_linear, linear_to_srgb, srgb_to_linear]


@pytest.mark.parametrize("encoding", ["linear", "srgb", "gamma22"])
def test_decode_undoes_encode(encoding):
    np.testing.assert_allclose(
        decode_to_linear(encode_linear(RAMP, encoding), encoding), RAMP, atol=1e-6
    )
    np.testing.assert_allclose(
        encode_linear(decode_to_linear(RAMP, encoding), encoding), RAMP, atol=5e-5
    )


@pytest.mark.parametrize("bits", [8, 16])
def test_every_stored_srgb_level_survives_linear_light(bits):
    top = 2**bits - 1
    levels = np.arange(top + 1)
    pixels = levels.astype(np.float32) / np.float32(top)
    again = linear_to_srgb(srgb_to_linear(pixels))
    np.testing.assert_array_equal(np.round(again * top), levels)


@pytest.mark.parametrize("curve", CURVES)
def test_curves_rise_from_0_to_1_and_clip(curve):
    values = curve(RAMP)
    assert np.all(np.diff(values.astype(np.float64)) >= 0.0)
    assert values[0] == 0.0
    assert values[-1] == pytest.approx(1.0, abs=1e-6)
    outside = curve(np.float32([-1.0, -1e-30, 2.0, 3e38, np.inf, -np.inf]))
    np.testing.assert_allclose(outside, [0.0, 0.0, 1.0, 1.0, 1.0, 0.0], atol=1e-6)
    assert values.dtype == np.float32
    assert values.max() <= 1.0


def test_srgb_is_the_standard():
    """IEC 61966-2-1: both pieces, their joint, and the mid grey everyone knows."""
    np.testing.assert_allclose(
        srgb_to_linear(np.float32([0.04045, 0.02, 0.5, 0.735357])),
        [0.04045 / 12.92, 0.02 / 12.92, 0.21404114, 0.5],
        atol=1e-6,
    )
    joint = np.float32([0.0031308 - 1e-7, 0.0031308, 0.0031308 + 1e-7])
    assert np.ptp(linear_to_srgb(joint)) < 1e-5
    below, above = linear_to_srgb(np.float32([0.003, 0.0033]))
    assert below == pytest.approx(12.92 * 0.003)
    assert above == pytest.approx(1.055 * 0.0033 ** (1 / 2.4) - 0.055)


def test_gamma22_is_a_power():
    assert linear_to_gamma22(np.float32([0.25]))[0] == pytest.approx(0.25 ** (1 / 2.2))
    assert gamma22_to_linear(np.float32([0.5]))[0] == pytest.approx(0.5**2.2)


@given(arrays.arrays(np.float32, (3, 2, 3), elements=st.floats(width=32, allow_nan=False)))
def test_linear_is_left_alone(image):
    assert encode_linear(image, "linear") is image
    assert decode_to_linear(image, "linear") is image


@pytest.mark.parametrize("curve", CURVES)
def test_nan_is_not_hidden_and_inputs_are_not_written_to(curve):
    image = np.float32([0.5, np.nan])
    image.setflags(write=False)
    assert np.isnan(curve(image)[1])


def test_luma_weighs_green_most():
    image = np.float32([[[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]])
    got = luma(image)
    np.testing.assert_allclose(got, [[0.299, 0.587, 0.114, 1.0]], atol=1e-6)
    assert got.dtype == np.float32
