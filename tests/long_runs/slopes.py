"""Whether a quantity grows over a run: a fitted line, and how sure its slope is."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["Slope", "resident_bytes", "slope_of"]

BLOCKS = 20
"""Neighbouring measurements depend on each other; means over so many stretches hardly do."""
T_995 = 2.88
"""Student's t for 99 % between both ends, with eighteen degrees of freedom."""


@dataclass(frozen=True)
class Slope:
    """Growth over the whole run, and the interval that holds it with 99 % confidence."""

    growth: float
    low: float
    high: float
    mean: float


def slope_of(values: Sequence[float]) -> Slope:
    """Fit a line to measurements taken evenly over a run, by means of blocks of them."""
    means = np.array([block.mean() for block in np.array_split(np.asarray(values), BLOCKS)])
    x = np.linspace(0.0, 1.0, BLOCKS)
    spread = x - x.mean()
    variance = float(spread @ spread)
    growth = float(spread @ means) / variance
    rest = means - means.mean() - growth * spread
    error = math.sqrt(float(rest @ rest) / (BLOCKS - 2) / variance)
    return Slope(growth, growth - T_995 * error, growth + T_995 * error, float(means.mean()))


def resident_bytes() -> int:
    """Of this process, by Linux's own account.

    What was freed is given back first where the C library can: what it keeps moves by most of a
    megabyte from relight to relight, and a leak smaller than that would not be noticed.
    """
    give_back = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if give_back is not None:
        give_back(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096
