"""The same of real models, which have no float64: what small changes do, once or at every step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import spotlight_runtime
from spotlight_bench.stability import NUDGE, UNIT_ROUNDOFF, nudged, relative_change
from spotlight_runtime import Light, Relighter, Scene
from spotlight_runtime.diffusion.sampler import LoopInputs, Predict, shadow_guided
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import make_solver
from spotlight_runtime.errors import NumericalError
from spotlight_runtime.networks.codec import encode_conditioning
from spotlight_runtime.networks.models import open_networks, predictor, resolve_model

__all__ = ["GAMMAS", "ModelMeasured", "measure_model"]

FloatArray = npt.NDArray[np.floating[Any]]
GAMMAS: Final = (1.0, 3.0, 7.0, 15.0)
SCENE: Final = Path(spotlight_runtime.__file__).parent / "demo" / "bench"
LIGHT: Final = Light(azimuth=135.0, elevation=45.0)


@dataclass(frozen=True, slots=True)
class ModelMeasured:
    """One model at one γ.

    Attributes
    ----------
    model, precision : str
    gamma : float
    refused : str
        The documented error it ended in; empty where it ran through.
    sensitivities : tuple of float
        As in `spotlight_bench.stability.Measured`.
    rounded : tuple of float
        Relative change after each step when every value of every prediction is multiplied by
        1 ± 2u at random, u being float32's unit roundoff: as if all were rounded once more.
    """

    model: str
    precision: str
    gamma: float
    refused: str
    sensitivities: tuple[float, ...]
    rounded: tuple[float, ...]


def measure_model(
    model: str,
    gammas: Sequence[float] = GAMMAS,
    report: Callable[[str], None] = lambda line: None,
    threads: int | None = None,
) -> Iterator[ModelMeasured]:
    """Relight the scene that comes along, at its usual number of steps.

    Parameters
    ----------
    model : str
        Name or folder.
    gammas : sequence of float
    report : callable
        Told what is being done.
    threads : int, optional
    """
    folder = resolve_model(model)
    facts = folder.summary()
    networks = open_networks(folder, threads=threads)
    relighter = Relighter(folder.manifest.backbone, networks, remember=0)
    inputs = relighter.loop_inputs(Scene.load(SCENE), LIGHT, denoise=False)
    condition = encode_conditioning(networks, inputs.conditioning)
    predict = predictor(networks, condition, relighter.spec.schedule)
    schedule = Schedule.trailing(relighter.spec.schedule, relighter.spec.schedule.steps)

    def latents(gamma: float, given: LoopInputs, network: Predict) -> list[FloatArray]:
        run = shadow_guided(network, given, make_solver("ddim", schedule), gamma=gamma)
        return [step.latents for step in run]

    for gamma in gammas:
        report(f"{facts['name']}, γ = {gamma:g}")
        try:
            usual = latents(gamma, inputs, predict)
            moved = latents(gamma, nudged(inputs), predict)
            rounded = latents(gamma, inputs, _rounded_again(predict))
        except NumericalError as error:
            yield ModelMeasured(facts["name"], facts["precision"], gamma, str(error), (), ())
            continue
        yield ModelMeasured(
            model=facts["name"],
            precision=facts["precision"],
            gamma=gamma,
            refused="",
            sensitivities=tuple(relative_change(a, b) / NUDGE for a, b in zip(moved, usual)),
            rounded=tuple(relative_change(a, b) for a, b in zip(rounded, usual)),
        )


def _rounded_again(predict: Predict) -> Predict:
    """A network whose every value is off by about one unit roundoff, up or down."""
    rng = np.random.default_rng(0)

    def off(latents: FloatArray, timestep: int) -> FloatArray:
        v = predict(latents, timestep)
        sign = rng.choice((-1.0, 1.0), v.shape)
        return np.asarray((v * (1.0 + 2.0 * UNIT_ROUNDOFF * sign)).astype(v.dtype))

    return off
