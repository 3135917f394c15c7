"""Guiding shadows: what the object's shadow would be under a light, cast on the background."""

from __future__ import annotations

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.lights import Light
from spotlight_runtime.scene import Scene

__all__ = ["cast_shadow"]


def cast_shadow(scene: Scene, light: Light, *, samples: int | None = None) -> FloatArray:
    """Cast the object's shadow on the background.

    Returns
    -------
    ndarray of float32, shape (H, W)
        In [0, 1]: 1 fully shadowed, 0 under the object.
    """
    raise NotImplementedError
