"""Means over scenes with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

__all__ = ["Estimate", "by_scene", "difference", "estimate"]

RESAMPLES: Final = 2000
LEVEL: Final = 95.0
"""Per cent of the resampled means that lie in the interval."""
SEED: Final = 0
"""The same scenes are drawn for every method, so intervals differ by the methods alone."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A mean over scenes and its bootstrap interval.

    Attributes
    ----------
    mean, low, high : float
    scenes : int
    """

    mean: float
    low: float
    high: float
    scenes: int


def by_scene(values: Sequence[tuple[str, float | None]]) -> dict[str, float]:
    """Mean of each scene's values, by scene; scenes without any are left out.

    A scene's directions share its object and room, so the scene, not the picture, is what was
    drawn at random, and what is resampled.
    """
    grouped: dict[str, list[float]] = {}
    for scene, value in values:
        if value is not None:
            grouped.setdefault(scene, []).append(value)
    return {scene: float(np.mean(found)) for scene, found in grouped.items()}


def estimate(
    values: Mapping[str, float], *, resamples: int = RESAMPLES, seed: int = SEED
) -> Estimate | None:
    """Mean over scenes with a 95 % percentile bootstrap interval; None without scenes.

    Parameters
    ----------
    values : mapping of str to float
        By scene. Their order does not matter.
    resamples : int
        Bootstrap samples.
    seed : int
    """
    if not values:
        return None
    ordered = np.array([values[scene] for scene in sorted(values)])
    means = _resampled_means(ordered, resamples, seed)
    low, high = np.percentile(means, [(100.0 - LEVEL) / 2, (100.0 + LEVEL) / 2])
    return Estimate(float(ordered.mean()), float(low), float(high), len(ordered))


def difference(
    one: Mapping[str, float], other: Mapping[str, float], *, seed: int = SEED
) -> Estimate | None:
    """Paired difference, one less other, over the scenes both have."""
    shared = set(one) & set(other)
    return estimate({scene: one[scene] - other[scene] for scene in shared}, seed=seed)


def _resampled_means(
    values: npt.NDArray[np.float64], resamples: int, seed: int
) -> npt.NDArray[np.float64]:
    drawn = np.random.default_rng(seed).integers(0, len(values), (resamples, len(values)))
    return np.asarray(values[drawn].mean(axis=1))
