"""How rounding errors grow over the steps of a run, and what a small change of its input does.

Every case runs in float64, which `tests/hard_cases` holds to an independent oracle to 1e-11, and
in the precisions models are stored in. Errors are relative: ‖z − z₆₄‖ / ‖z₆₄‖ over both branches'
latents after a step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from spotlight_bench.stability_cases import LoopCase
from spotlight_bench.stability_network import PRECISIONS, Precision, SmallDenoiser
from spotlight_runtime.diffusion.sampler import LoopInputs, Predict, shadow_guided
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import make_solver
from spotlight_runtime.errors import NumericalError
from spotlight_spec import ScheduleSpec

__all__ = [
    "NUDGE",
    "REDUCED",
    "UNIT_ROUNDOFF",
    "Measured",
    "in_float64",
    "measure",
    "measure_all",
    "nudged",
    "relative_change",
    "trajectory",
]

FloatArray = npt.NDArray[np.floating[Any]]
NUDGE: Final = 1e-6
"""Relative change of the starting latents that sensitivity is measured with."""
REDUCED: Final[tuple[Precision, ...]] = PRECISIONS[1:]
UNIT_ROUNDOFF: Final = 2.0**-24
"""Largest relative error of one float32 operation."""
SCHEDULE: Final = ScheduleSpec()


@dataclass(frozen=True, slots=True)
class Measured:
    """One case in one precision.

    Attributes
    ----------
    case, precision : str
    refused : str
        The documented error it ended in; empty where it ran through.
    errors : tuple of float
        Relative error to float64 after each step.
    sensitivities : tuple of float
        Relative change of the latents after each step, in units of the relative change of the
        starting latents (`NUDGE`).
    at_once : float
        Relative error where the same case takes the whole way in one step.
    """

    case: str
    precision: Precision
    refused: str
    errors: tuple[float, ...]
    sensitivities: tuple[float, ...]
    at_once: float

    @property
    def finite(self) -> bool:
        """Whether all latents are finite; others are refused."""
        return not self.refused

    @property
    def one_step(self) -> float:
        """Error of one step: of the first, or of the only one if that goes all the way.

        The first of many is so short that a network's errors hardly count in it.
        """
        return max(self.errors[0], self.at_once)

    @property
    def growth(self) -> float:
        """Error after the last step over that of one."""
        return self.errors[-1] / self.one_step


def trajectory(case: LoopCase, inputs: LoopInputs, predict: Predict) -> list[FloatArray]:
    """Latents of both branches after each step."""
    schedule = Schedule.trailing(SCHEDULE, case.steps)
    run = shadow_guided(
        predict,
        inputs,
        make_solver(case.solver, schedule),
        gamma=case.gamma,
        beta=case.beta,
        guidance_rescale=case.rescale,
        fidelity=case.fidelity,
    )
    return [step.latents for step in run]


def nudged(inputs: LoopInputs) -> LoopInputs:
    """The same with its starting latents changed by `NUDGE` of their norm, in all directions."""
    start = inputs.initial_noise.astype(np.float64)
    direction = np.random.default_rng(0).standard_normal(start.shape)
    size = NUDGE * np.linalg.norm(start) / np.linalg.norm(direction)
    moved = (start + size * direction).astype(inputs.initial_noise.dtype)
    return replace(inputs, initial_noise=moved)


def relative_change(actual: FloatArray, expected: FloatArray) -> float:
    """‖actual − expected‖ / ‖expected‖ in float64."""
    # The norm of denormals is taken of numbers that their squares do not vanish of.
    scale = float(np.abs(expected).max()) or 1.0
    wanted = expected.astype(np.float64) / scale
    apart = (actual.astype(np.float64) - expected.astype(np.float64)) / scale
    return float(np.linalg.norm(apart) / (np.linalg.norm(wanted) or 1.0))


def in_float64(case: LoopCase) -> list[FloatArray]:
    """What a case is measured against."""
    return trajectory(case, case.inputs(np.float64), SmallDenoiser(case.condition()))


def measure(case: LoopCase, precision: Precision, exact: Sequence[FloatArray]) -> Measured:
    """Run a case, its nudged twin and the case in one step, in a precision.

    Parameters
    ----------
    case : LoopCase
    precision : str
    exact : sequence of ndarray
        `in_float64` of the case.
    """
    network = SmallDenoiser(case.condition(), precision)
    inputs, short = case.inputs(network.dtype), replace(case, steps=1)
    try:
        latents = trajectory(case, inputs, network)
        moved = trajectory(case, nudged(inputs), network)
        at_once = trajectory(short, short.inputs(network.dtype), network)
    except NumericalError as error:
        return Measured(case.name, precision, str(error), (), (), 0.0)
    start, moved_start = inputs.initial_noise, nudged(inputs).initial_noise
    given = relative_change(moved_start, start) or NUDGE
    return Measured(
        case=case.name,
        precision=precision,
        refused="",
        errors=tuple(relative_change(a, b) for a, b in zip(latents, exact)),
        sensitivities=tuple(relative_change(a, b) / given for a, b in zip(moved, latents)),
        at_once=relative_change(at_once[0], in_float64(short)[0]),
    )


def measure_all(
    cases: Iterable[LoopCase],
    precisions: Sequence[Precision] = REDUCED,
    report: Callable[[str], None] = lambda line: None,
) -> Iterator[Measured]:
    """Measure cases in precisions, one by one."""
    for case in cases:
        report(case.name)
        exact = in_float64(case)
        for precision in precisions:
            yield measure(case, precision, exact)
