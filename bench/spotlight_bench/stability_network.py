"""A small denoiser whose arithmetic is known: the same network in four precisions.

Real graphs run in float32 at best, so an error of theirs has no float64 to be measured against.
This one is written in numpy: two 3×3 convolutions around a tanh, over latents, condition and time,
plus the straight line that is right for latents of small variance. Its weights are random; what
counts here is only that it is smooth, mixes pixels and channels, and answers changes of its input
about as strongly as a trained denoiser.
"""

from __future__ import annotations

from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

__all__ = ["CHANNELS", "CONDITION_CHANNELS", "PRECISIONS", "Precision", "SmallDenoiser"]

FloatArray = npt.NDArray[np.floating[Any]]
Precision = Literal["fp64", "fp32", "fp16", "int8"]
PRECISIONS: Final[tuple[Precision, ...]] = get_args(Precision)

CHANNELS: Final = 4
CONDITION_CHANNELS: Final = 3
HIDDEN: Final = 8
TRAIN_STEPS: Final = 1000.0
GAIN: Final = 1.5
"""Of the hidden layer, so that the network's Lipschitz constant comes to about one."""
CALIBRATED: Final = 4.0
"""Largest input int8 was calibrated on; unit Gaussian latents stay below it, others saturate."""
LEVELS: Final = 127.0
"""Of symmetric int8."""


class SmallDenoiser:
    """``v(z, t)`` of branches with a condition each.

    Parameters
    ----------
    condition : ndarray, shape (branches, CONDITION_CHANNELS, h, w)
    precision : {"fp64", "fp32", "fp16", "int8"}
        ``fp16`` stores the weights in half and computes in float32, as exported models do;
        ``int8`` stores weights by channel and rounds the inputs of both convolutions to 255
        levels of a calibrated range, beyond which they saturate.
    seed : int
        Of the weights.
    """

    def __init__(self, condition: FloatArray, precision: Precision = "fp64", seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        incoming = CHANNELS + CONDITION_CHANNELS
        first = rng.normal(0.0, GAIN / np.sqrt(9 * incoming), (HIDDEN, incoming, 3, 3))
        second = rng.normal(0.0, 1.0 / np.sqrt(9 * HIDDEN), (CHANNELS, HIDDEN, 3, 3))
        self._time = rng.normal(0.0, 0.5, (HIDDEN, 1, 1))
        self.dtype = np.dtype(np.float64 if precision == "fp64" else np.float32)
        self._first, self._second = (
            _stored(weight, precision).astype(self.dtype) for weight in (first, second)
        )
        self._time = self._time.astype(self.dtype)
        self._condition = condition.astype(self.dtype)
        self._quantised = precision == "int8"

    def __call__(self, latents: FloatArray, timestep: int) -> FloatArray:
        """Predict v of the first branches; see `spotlight_runtime.diffusion.sampler.Predict`."""
        z = latents.astype(self.dtype)
        x = np.concatenate([z, self._condition[: len(z)]], axis=1)
        hidden = _convolved(self._rounded(x, CALIBRATED), self._first)
        hidden = np.tanh(hidden + self._time * self.dtype.type(timestep / TRAIN_STEPS))
        return _convolved(self._rounded(hidden, 1.0), self._second)

    def _rounded(self, x: FloatArray, limit: float) -> FloatArray:
        if not self._quantised:
            return x
        step = self.dtype.type(limit / LEVELS)
        return np.clip(np.rint(x / step), -LEVELS, LEVELS).astype(self.dtype) * step


def _stored(weight: FloatArray, precision: Precision) -> FloatArray:
    """A weight as it comes back from a file of that precision."""
    if precision == "fp16":
        return weight.astype(np.float16).astype(np.float32)
    if precision == "int8":
        step = np.abs(weight).max(axis=(1, 2, 3), keepdims=True) / LEVELS
        return np.rint(weight / step) * step
    return weight


def _convolved(x: FloatArray, weight: FloatArray) -> FloatArray:
    """3×3, zeros around: (n, c, h, w) by (o, c, 3, 3) to (n, o, h, w)."""
    height, width = x.shape[2:]
    padded = np.pad(x, ((0, 0), (0, 0), (1, 1), (1, 1)))
    windows = np.stack(
        [padded[:, :, i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=2
    )
    flat = weight.reshape(*weight.shape[:2], 9)
    out: FloatArray = np.einsum("nckhw,ock->nohw", windows, flat, optimize=True)
    return out
