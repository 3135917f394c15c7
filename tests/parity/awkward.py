"""Masks and images that stages tend to stumble over."""

from __future__ import annotations

import numpy as np

__all__ = ["IMAGE_SIZES", "MASKS", "mask_named"]

IMAGE_SIZES = [(16, 16), (40, 24), (64, 96), (264, 376)]
"""Square, odd latents (5×3), and the 33×47 latents that break skip connections."""

MASKS = ["empty", "full", "soft", "sparse", "line", "corner", "pixel"]


def mask_named(name: str, size: tuple[int, int], seed: int = 0) -> np.ndarray:
    """A float32 mask in [0, 1] of that size."""
    rng = np.random.default_rng(seed)
    mask = np.zeros(size, np.float32)
    if name == "full":
        mask[:] = 1.0
    elif name == "soft":
        mask[:] = rng.uniform(size=size)
    elif name == "sparse":
        mask[:] = rng.uniform(size=size) > 0.98
    elif name == "line":
        mask[:, size[1] // 3] = 1.0
    elif name == "corner":
        mask[size[0] // 2 :, size[1] // 2 :] = 1.0
    elif name == "pixel":
        mask[size[0] - 1, 0] = 1.0
    return mask
