"""The guiding shadows of the parity scene: one wanted, and three ways to have a negative."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from support.scenes import make_shadow

from spotlight_runtime import Scene

__all__ = ["NEGATIVES", "Negative", "wanted_shadow"]

Negative = Literal["opposite", "none", "second drawing"]


def wanted_shadow(scene: Scene) -> np.ndarray:
    """A soft shadow left of the object."""
    return make_shadow(scene, "left")


def _scribble(scene: Scene) -> np.ndarray:
    """A hard diagonal stroke that also crosses the object."""
    rows, columns = np.mgrid[: scene.size[0], : scene.size[1]]
    return (np.abs(rows - 0.6 * columns) < 6.0).astype(np.float32)


NEGATIVES: dict[Negative, Callable[[Scene], np.ndarray]] = {
    "opposite": lambda scene: make_shadow(scene, "right"),
    "none": lambda scene: np.zeros(scene.size, np.float32),
    "second drawing": _scribble,
}
