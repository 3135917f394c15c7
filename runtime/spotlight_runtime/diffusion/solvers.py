"""ODE solvers that carry latents from one noise level to the next.

All take a v-prediction and work on any batch of branches. Scalars are float64, arrays stay in their
own dtype. Notation: α = √ᾱ, σ = √(1−ᾱ), λ = log(α/σ), h = λ_next − λ.

* `DDIM` (Song et al. 2021, η = 0): a rotation of (z, v); the released method.
* `DPMSolverPP` (Lu et al. 2022, "DPM-Solver++" 2M, midpoint): two steps' x0, for fewer steps.
* `UniPC` (Zhao et al. 2023, order 2, B₂(h) = e^h − 1): adds a corrector that costs no evaluation.
"""

from __future__ import annotations

import math
from typing import Final, Literal, Protocol

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.errors import InvalidInputError

__all__ = ["DDIM", "SOLVERS", "DPMSolverPP", "Solver", "SolverName", "UniPC", "make_solver"]

SolverName = Literal["ddim", "dpmpp_2m", "unipc"]


class Solver(Protocol):
    """One trajectory's solver; multistep solvers remember, so make a new one for each run."""

    schedule: Schedule

    def step(self, i: int, z: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take step ``i`` (they must come in order) from latents ``z`` with prediction ``v``.

        Returns
        -------
        z_next : ndarray, shape of ``z``
            Latents at the next noise level.
        x0 : ndarray, shape of ``z``
            The clean latents predicted at this step.
        """
        ...


class DDIM:
    """Deterministic DDIM."""

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule

    def step(self, i: int, z: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Denoising step ``i``; see `Solver`."""
        alpha, sigma = _alpha_sigma(self.schedule, i)
        alpha_next, sigma_next = _alpha_sigma(self.schedule, i + 1)
        x0 = _predicted_x0(self.schedule, i, z, v)
        epsilon = alpha * v + sigma * z
        return alpha_next * x0 + sigma_next * epsilon, x0


class DPMSolverPP:
    """DPM-Solver++ 2M. The last step is first order: it lands on x0."""

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule.for_multistep()
        self._previous_x0: FloatArray | None = None

    def step(self, i: int, z: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Denoising step ``i``; see `Solver`."""
        x0 = _predicted_x0(self.schedule, i, z, v)
        z_next = _first_order(self.schedule, i, z, x0)
        if self._previous_x0 is not None and i < len(self.schedule) - 1:
            alpha_next, _ = _alpha_sigma(self.schedule, i + 1)
            h, h_before = _log_snr_step(self.schedule, i), _log_snr_step(self.schedule, i - 1)
            slope = (x0 - self._previous_x0) * (h / h_before)
            z_next = z_next - (0.5 * alpha_next * math.expm1(-h)) * slope
        self._previous_x0 = x0
        return z_next, x0


class UniPC:
    """UniPC of order 2 in B₂(h), predicting x0.

    The corrector revises the latents a step arrived at, using the prediction made there. It is
    applied as the *difference* it makes to the predictor's result, so that what was blended into
    the latents between two steps stays in them; without blending that is the published update.
    """

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule.for_multistep()
        self._x0: list[FloatArray] = []
        self._order = 0

    def step(self, i: int, z: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Denoising step ``i``; see `Solver`."""
        x0 = _predicted_x0(self.schedule, i, z, v)
        if i > 0:
            z = z + self._correction(i - 1, x0)
        self._order = min(2, len(self.schedule) - i, self._order + 1)
        self._x0 = [*self._x0[-1:], x0]
        z_next = _first_order(self.schedule, i, z, x0)
        if self._order == 2:
            z_next = z_next - self._weight(i) * 0.5 * self._backward_difference(i)
        return z_next, x0

    def _weight(self, i: int) -> float:
        """α_next · B(h) of step ``i``."""
        alpha_next, _ = _alpha_sigma(self.schedule, i + 1)
        return alpha_next * math.expm1(-_log_snr_step(self.schedule, i))

    def _ratio(self, i: int) -> float:
        """r = (λ_{i−1} − λ_i) / h_i, negative."""
        return -_log_snr_step(self.schedule, i - 1) / _log_snr_step(self.schedule, i)

    def _backward_difference(self, i: int) -> FloatArray:
        """(x0_{i−1} − x0_i) / r of the two remembered predictions."""
        before, now = self._x0
        return (before - now) / self._ratio(i)

    def _correction(self, i: int, x0: FloatArray) -> FloatArray:
        """Corrector minus predictor of step ``i``, given the x0 predicted where it arrived."""
        forward = x0 - self._x0[-1]
        if self._order == 1:
            return -self._weight(i) * 0.5 * forward
        hh = -_log_snr_step(self.schedule, i)
        b_h = math.expm1(hh)
        phi_2 = b_h / hh - 1.0
        b = np.array([phi_2 / b_h, (phi_2 / hh - 0.5) * 2.0 / b_h])
        rho = np.linalg.solve(np.array([[1.0, 1.0], [self._ratio(i), 1.0]]), b)
        backward = self._backward_difference(i)
        return -self._weight(i) * ((float(rho[0]) - 0.5) * backward + float(rho[1]) * forward)


SOLVERS: Final[dict[SolverName, type[DDIM] | type[DPMSolverPP] | type[UniPC]]] = {
    "ddim": DDIM,
    "dpmpp_2m": DPMSolverPP,
    "unipc": UniPC,
}


def make_solver(name: SolverName, schedule: Schedule) -> Solver:
    """Make a fresh solver of that name.

    Raises
    ------
    InvalidInputError
        If there is no such solver.
    """
    if name not in SOLVERS:
        raise InvalidInputError(f"solver: expected one of {', '.join(SOLVERS)}, got {name!r}")
    return SOLVERS[name](schedule)


def _alpha_sigma(schedule: Schedule, i: int) -> tuple[float, float]:
    alpha_bar = float(schedule.alpha_bar[i])
    return math.sqrt(alpha_bar), math.sqrt(1.0 - alpha_bar)


def _predicted_x0(schedule: Schedule, i: int, z: FloatArray, v: FloatArray) -> FloatArray:
    """x0 = α z − σ v (Salimans & Ho 2022)."""
    alpha, sigma = _alpha_sigma(schedule, i)
    x0 = alpha * z - sigma * v
    return np.clip(x0, -1.0, 1.0) if schedule.clip_sample else x0


def _first_order(schedule: Schedule, i: int, z: FloatArray, x0: FloatArray) -> FloatArray:
    """Exponential-integrator step with constant x0; e^{−h} is a quotient, so σ = 0 is fine."""
    alpha, sigma = _alpha_sigma(schedule, i)
    alpha_next, sigma_next = _alpha_sigma(schedule, i + 1)
    decay = (alpha * sigma_next) / (sigma * alpha_next)
    return (sigma_next / sigma) * z + (alpha_next * (1.0 - decay)) * x0


def _log_snr_step(schedule: Schedule, i: int) -> float:
    """h = λ_{i+1} − λ_i, for all steps but the last, where σ reaches 0."""
    alpha, sigma = _alpha_sigma(schedule, i)
    alpha_next, sigma_next = _alpha_sigma(schedule, i + 1)
    return math.log(alpha_next / sigma_next) - math.log(alpha / sigma)
