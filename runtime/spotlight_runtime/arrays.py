"""Array types, and the checks that arrays from outside and out of networks pass."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spotlight_runtime.errors import (
    DtypeError,
    InvalidInputError,
    NonFiniteError,
    NumericalError,
    ShapeError,
)

__all__ = ["BoolArray", "FloatArray", "check_array", "pad_edge", "require_finite", "sparse_copy"]

FloatArray = npt.NDArray[np.floating[Any]]
"""Float32 wherever pixels and latents flow; the same functions accept float64."""
BoolArray = npt.NDArray[np.bool_]

SLACK = 1e-3
"""8-bit normals and half floats leave their range by less than this."""


def check_array(
    value: FloatArray,
    name: str,
    size: tuple[int, int],
    channels: int | None,
    limits: tuple[float, float],
) -> None:
    """Raise unless ``value`` is a finite float32 array of that size, channels and range.

    Raises
    ------
    DtypeError, ShapeError, NonFiniteError, InvalidInputError
        Naming the array, what was expected and what came.
    """
    if not isinstance(value, np.ndarray) or value.dtype != np.float32:
        got = getattr(value, "dtype", type(value).__name__)
        raise DtypeError(f"{name}: expected a float32 array, got {got}; convert it first")
    shape = size if channels is None else (*size, channels)
    if value.shape != shape:
        raise ShapeError(f"{name}: expected shape {shape}, got {value.shape}")
    if value.size == 0:
        raise ShapeError(f"{name}: the array is empty, shape {value.shape}")
    low, high = float(value.min()), float(value.max())
    if not (np.isfinite(low) and np.isfinite(high)):
        bad = int(value.size - np.isfinite(value).sum())
        raise NonFiniteError(f"{name}: {bad} of {value.size} values are NaN or infinite")
    if low < limits[0] - SLACK or high > limits[1] + SLACK:
        raise InvalidInputError(
            f"{name}: expected values in [{limits[0]:g}, {limits[1]:g}], got [{low:g}, {high:g}]"
        )


def require_finite(
    array: FloatArray,
    stage: str,
    remedy: str = "if the model is fp16 or int8, it may overflow: try one of precision fp32",
) -> None:
    """Raise unless every value is finite: of all a network says, where it says it.

    Parameters
    ----------
    array : ndarray of float
    stage : str
        What it is, with the step where there is one: begins the message.
    remedy : str
        Ends it.

    Raises
    ------
    NumericalError
        Naming the stage, how many values are not finite, and the remedy.
    """
    finite = np.isfinite(array)
    if not finite.all():
        bad = int(array.size - finite.sum())
        raise NumericalError(f"{stage}: {bad} of {array.size} values are NaN or infinite; {remedy}")


def pad_edge(array: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Grow an image (H, W) or (H, W, C) to the right and below by repeating its border."""
    grow = [(0, size[0] - array.shape[0]), (0, size[1] - array.shape[1])]
    return np.pad(array, grow + [(0, 0)] * (array.ndim - 2), mode="edge")


def sparse_copy(array: FloatArray) -> FloatArray:
    """A copy that takes memory only where the array is not zero, to the page.

    Maps of an object are empty outside it, and of a 12-megapixel photograph an empty map takes 48
    or 144 megabytes. Zeros that nobody wrote are not there until somebody does.
    """
    covered = array != 0.0
    if covered.ndim == 3:
        covered = covered.any(axis=2)
    rows, columns = (np.flatnonzero(covered.any(axis=axis)) for axis in (1, 0))
    copy = np.zeros(array.shape, dtype=array.dtype)
    if len(rows):
        inside = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        copy[inside] = array[inside]
    return copy
