"""A hard case: its name, why it is hard, and what is to come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["Case", "Refusal", "compare", "exact", "planes"]


@dataclass(frozen=True)
class Case:
    """An input on which the runtime agrees with the oracle.

    Attributes
    ----------
    name, why : str
    build : callable
        → what the runtime makes of it, and what the oracle does.
    relative, absolute : float
        Tolerance: max |a − e| ≤ absolute + relative · max |e|.
    full : bool
        Too slow for every day.
    """

    name: str
    why: str
    build: Callable[[], tuple[Any, Any]]
    relative: float = 2e-6
    absolute: float = 0.0
    full: bool = False


@dataclass(frozen=True)
class Refusal:
    """An input that ends in a documented error.

    Attributes
    ----------
    name, why : str
    act : callable
        Gives it to the runtime.
    error : type of Exception
    message : str
        A pattern of what the error says.
    """

    name: str
    why: str
    act: Callable[[], object]
    error: type[Exception]
    message: str


def compare(case: Case) -> float:
    """The error of a case in units of its tolerance; fails where something is not finite."""
    actual, expected = (np.asarray(each) for each in case.build())
    assert actual.shape == expected.shape, f"{case.name}: {actual.shape} is not {expected.shape}"
    assert np.isfinite(actual).all(), f"{case.name}: the runtime's result is not finite"
    assert np.isfinite(expected).all(), f"{case.name}: the oracle's result is not finite"
    apart = float(np.abs(actual.astype(np.float64) - expected).max(initial=0.0))
    allowed = case.absolute + case.relative * float(np.abs(expected).max(initial=0.0))
    return apart / allowed if allowed > 0.0 else float(apart > 0.0)


def exact(array: np.ndarray) -> Tensor:
    """The same numbers in float64, the axes as they are."""
    return torch.from_numpy(np.asarray(array).astype(np.float64))


def planes(array: np.ndarray) -> Tensor:
    """(H, W) or (H, W, C) → float64 (C, H, W)."""
    return exact(np.atleast_3d(array).transpose(2, 0, 1))
