"""Every array from outside passes one check; what is wrong is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from spotlight_runtime.arrays import check_array, pad_edge
from spotlight_runtime.errors import (
    DtypeError,
    InvalidInputError,
    NonFiniteError,
    ShapeError,
    SpotLightError,
)

UNIT = (0.0, 1.0)


@pytest.mark.parametrize(
    "dtype", ["float64", "float16", ">f4", "uint8", "int64", "bool", "complex64", "object", "U1"]
)
def test_other_dtypes_are_named(dtype):
    with pytest.raises(DtypeError, match=r"shadow: expected a float32 array, got "):
        check_array(np.zeros((4, 4), dtype=dtype), "shadow", (4, 4), None, UNIT)


@pytest.mark.parametrize("value", [None, 1.0, [[0.0]], "picture"])
def test_what_is_no_array_is_named(value):
    with pytest.raises(DtypeError, match=type(value).__name__):
        check_array(value, "shadow", (1, 1), None, UNIT)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_values_are_counted(bad):
    value = np.zeros((4, 5), np.float32)
    value[1, 2] = value[3, 4] = bad
    with pytest.raises(NonFiniteError, match="2 of 20 values"):
        check_array(value, "depth", (4, 5), None, (0.0, np.inf))


@pytest.mark.parametrize("value", [-0.01, 1.01, 255.0, 3e38, -3e38])
def test_values_out_of_range_are_shown(value):
    array = np.full((2, 2), value, np.float32)
    with pytest.raises(InvalidInputError, match=r"expected values in \[0, 1\], got \["):
        check_array(array, "mask", (2, 2), None, UNIT)


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, -5e-4, 1.0005])
def test_rounding_at_the_ends_of_the_range_is_allowed(value):
    check_array(np.full((2, 2), value, np.float32), "mask", (2, 2), None, UNIT)


def test_empty_arrays_have_no_values_to_relight():
    with pytest.raises(ShapeError, match="empty"):
        check_array(np.zeros((0, 4, 3), np.float32), "background", (0, 4), 3, UNIT)


def test_layout_in_memory_does_not_matter():
    base = np.zeros((8, 6, 3), np.float32)
    frozen = base.copy()
    frozen.setflags(write=False)
    for array in (base, np.asfortranarray(base), base[::-1], base[:, ::-1], frozen):
        check_array(array, "albedo", (8, 6), 3, UNIT)


@given(
    arrays.arrays(
        dtype=st.sampled_from([np.float32, np.float64, np.uint8, np.float16]),
        shape=arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
    )
)
def test_passes_exactly_the_documented_arrays(array):
    good = (
        array.dtype == np.float32
        and array.shape == (3, 4, 3)
        and bool(np.isfinite(array).all())
        and bool((array >= -1e-3).all() and (array <= 1.001).all())
    )
    if good:
        check_array(array, "albedo", (3, 4), 3, UNIT)
    else:
        with pytest.raises(SpotLightError, match=r"^albedo: "):
            check_array(array, "albedo", (3, 4), 3, UNIT)


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_padding_repeats_the_border_and_keeps_the_inside(shape, rng):
    image = rng.random(shape, dtype=np.float32)
    grown = pad_edge(image, (8, 8))
    np.testing.assert_array_equal(grown[:5, :7], image)
    for row in range(8):
        for column in range(8):
            np.testing.assert_array_equal(grown[row, column], image[min(row, 4), min(column, 6)])
