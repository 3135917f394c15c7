"""How far two arrays are apart, and whether that is close enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["Tolerance", "assert_within", "relative_error"]


@dataclass(frozen=True)
class Tolerance:
    """Bounds on max |a − e| / max |e|, and on max |a − e| itself."""

    relative: float
    absolute: float


def relative_error(actual: Any, expected: Any) -> float:
    """max |a − e| / max |e|."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    return float(np.abs(actual - expected).max() / np.abs(expected).max())


def assert_within(tolerance: Tolerance, actual: Any, expected: Any, where: str = "") -> None:
    """Fail unless shapes agree, all is finite, and both errors are within bounds."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape, where
    assert np.isfinite(actual).all(), where
    assert np.isfinite(expected).all(), where
    absolute = float(np.abs(actual - expected).max())
    relative = relative_error(actual, expected)
    assert relative <= tolerance.relative, f"{where}: relative error {relative:.2e}"
    assert absolute <= tolerance.absolute, f"{where}: absolute error {absolute:.2e}"
