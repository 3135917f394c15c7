"""Noise schedule: ᾱ per train step, and the levels an inference run walks through.

Computed in float64 and kept so: the schedule is a handful of scalars, and near zero terminal SNR
√ᾱ is a difference of nearly equal numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.errors import InvalidInputError
from spotlight_spec import ScheduleSpec

__all__ = ["MULTISTEP_TERMINAL_ALPHA", "Schedule", "alphas_cumprod"]

MULTISTEP_TERMINAL_ALPHA: Final = 2.0**-24
"""ᾱ that multistep solvers use in place of 0, where log-SNR is −∞; diffusers uses the same."""


def alphas_cumprod(spec: ScheduleSpec) -> npt.NDArray[np.float64]:
    """ᾱ_t of every train step.

    Parameters
    ----------
    spec : ScheduleSpec

    Returns
    -------
    ndarray of float64, shape (num_train_timesteps,)
        Decreasing; the last is exactly 0 with zero terminal SNR (Lin et al. 2023, algorithm 1:
        √ᾱ is shifted so that it ends at 0 and scaled so that its first value is kept).
    """
    n = spec.num_train_timesteps
    if spec.beta_schedule == "scaled_linear":
        betas = np.linspace(spec.beta_start**0.5, spec.beta_end**0.5, n) ** 2
    else:
        betas = np.linspace(spec.beta_start, spec.beta_end, n)
    alphas: npt.NDArray[np.float64] = np.cumprod(1.0 - betas, dtype=np.float64)
    if not spec.rescale_betas_zero_snr:
        return alphas
    root = np.sqrt(alphas)
    first, last = root[0], root[-1]
    return ((root - last) * (first / (first - last))) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """The noise levels of one inference run.

    Attributes
    ----------
    timesteps : ndarray of int64, shape (steps,)
        Train timesteps the network is asked at, decreasing.
    alpha_bar : ndarray of float64, shape (steps + 1,)
        ᾱ before each step, and after the last.
    clip_sample : bool
        Whether predicted x0 is clipped to [−1, 1].
    """

    timesteps: npt.NDArray[np.int64]
    alpha_bar: npt.NDArray[np.float64]
    clip_sample: bool = False

    def __len__(self) -> int:
        return len(self.timesteps)

    @classmethod
    def trailing(cls, spec: ScheduleSpec, steps: int) -> Schedule:
        """Evenly spaced timesteps counted from the last train step.

        Each step ends where the next begins, also where ``steps`` does not divide the train
        schedule (there diffusers' DDIM steps to t − ⌊T/steps⌋ instead, up to one train step off).

        Raises
        ------
        InvalidInputError
            If ``steps`` is not between 1 and the number of train steps.
        """
        n = spec.num_train_timesteps
        if isinstance(steps, bool) or not isinstance(steps, int) or not 1 <= steps <= n:
            raise InvalidInputError(f"steps: expected a whole number from 1 to {n}, got {steps!r}")
        timesteps = np.round(np.arange(steps, 0, -1) * (n / steps)).astype(np.int64) - 1
        alphas = alphas_cumprod(spec)
        final = 1.0 if spec.set_alpha_to_one else alphas[0]
        return cls(timesteps, np.append(alphas[timesteps], final), spec.clip_sample)

    def for_multistep(self) -> Schedule:
        """The same run as multistep solvers see it: finite log-SNR first, ᾱ = 1 last."""
        alpha_bar = np.maximum(self.alpha_bar, MULTISTEP_TERMINAL_ALPHA)
        alpha_bar[-1] = 1.0
        return Schedule(self.timesteps, alpha_bar, self.clip_sample)
