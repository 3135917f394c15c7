"""A relight made ready: what is asked for, planned and prepared, before any network runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, cast

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.sampler import Step
from spotlight_runtime.errors import BudgetError, InvalidInputError, NumericalError
from spotlight_runtime.planning.costs import Costs
from spotlight_runtime.planning.ladder import PlanName, named_rung, read_ladder
from spotlight_runtime.planning.options import OptionChanges, RelightOptions, WindowMode
from spotlight_runtime.planning.plan import Plan
from spotlight_runtime.planning.rules import Facts, make_plan, part_of
from spotlight_runtime.relighting.facts import scene_facts, softness
from spotlight_runtime.relighting.guides import Guide, Negative, giving_light, guiding_shadows
from spotlight_runtime.relighting.passes import denoising
from spotlight_runtime.relighting.preparation import Prepared, prepare_window
from spotlight_runtime.relighting.remembered import Remembered, plain_key, view_digest
from spotlight_runtime.relighting.result import PassName, Progress, Stopwatch
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import BackboneSpec

__all__ = ["Task", "Wishes", "check_wishes", "prepare_task"]


class Wishes(OptionChanges, total=False):
    """Keywords of a relight: options by name, and a plan or a budget they start from.

    Attributes
    ----------
    plan : {"exact", "balanced", "draft"}
        The named plan (`spotlight_runtime.planning.ladder`).
    budget : float
        Seconds the relight may take on this machine: the most accurate plan that fits is run.
    """

    plan: PlanName
    budget: float


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A relight made ready to run.

    Attributes
    ----------
    prepared : Prepared
    options : RelightOptions
        With nothing left to default.
    plan : Plan
        What is to be run.
    parts : tuple of Plan
        What of it is for each of the lights, where each has a picture of its own.
    denoised : str
        ``on``, or why not.
    stopwatch : Stopwatch
    plain_key : str
        Names the picture without shadow, of this scene, seed and these steps.
    no_shadow : ndarray of float32, shape (h, w, 3), optional
        That picture, where it is known from before.
    """

    prepared: Prepared
    options: RelightOptions
    plan: Plan
    parts: tuple[Plan, ...]
    denoised: str
    stopwatch: Stopwatch
    plain_key: str
    no_shadow: FloatArray | None = None

    @property
    def lights(self) -> int:
        """How many lights there are."""
        return len(self.prepared.guides)

    def fresh(self) -> Task:
        """The same with a stopwatch of its own, for one more run."""
        return self.timed_by(Stopwatch(self.stopwatch.seconds))

    def timed_by(self, stopwatch: Stopwatch) -> Task:
        """The same with another stopwatch."""
        return replace(self, stopwatch=stopwatch)

    def only(self, number: int) -> Task:
        """The same with one of its lights; the first takes what was timed so far upon itself."""
        stopwatch = Stopwatch(self.stopwatch.seconds if number == 0 else None)
        alone = replace(self, prepared=self.prepared.only(number), plan=self.parts[number])
        return alone.timed_by(stopwatch)

    def drain(
        self, trajectory: Iterator[Step], stage: PassName, lights: range, steps: int
    ) -> Generator[Progress, None, FloatArray]:
        """Yield progress of a pass and return its final latents; the caller's time is not counted.

        Parameters
        ----------
        trajectory : iterator of Step
        stage : {"relight", "no shadow"}
        lights : range
            Which lights the pass is for; each is told of at every step.
        steps : int
            How many it has.

        Returns
        -------
        ndarray of float32, shape (branches, C, h, w)
            As `Step` has them.

        Raises
        ------
        NumericalError
            If something is not finite, naming pass and step.
        """
        while True:
            with self.stopwatch.stage(stage):
                try:
                    step = next(trajectory)
                except NumericalError as error:
                    which = " or ".join(str(light + 1) for light in lights)
                    of = f" of light {which}" if self.lights > 1 else ""
                    raise NumericalError(f"pass '{stage}'{of}, {error}") from error
            for light in lights:
                own = slice(light - lights.start, None, len(lights))
                seen = replace(step, latents=step.latents[own], denoised=step.denoised[own])
                yield Progress(stage, seen, steps, light, self.lights, self.prepared.window)
            if step.index == steps - 1:
                return step.latents


def prepare_task(
    spec: BackboneSpec,
    scene: Scene,
    light: Guide | Sequence[Guide],
    negative: Negative | None,
    options: RelightOptions | None,
    wishes: Wishes,
    remembered: Remembered,
    costs: Callable[[bool], Costs | None],
    reusable: bool = False,
    *,
    mixed: bool = False,
) -> Task:
    """Cast shadows, choose the plan and the window, and bring everything to the model's scale.

    Parameters
    ----------
    spec : BackboneSpec
    scene : Scene
    light, negative, options
        As `Relighter.relight` takes them.
    wishes : Wishes
        Changes to the options, a plan or a budget.
    remembered : Remembered
        Pictures without shadow known from before.
    costs : callable
        ``costs(needed)`` → what stages cost here; where not needed, None will do.
    reusable : bool
        Whether the model predicts from an earlier step's deep features, too.
    mixed : bool
        Whether all lights make one picture: those that give no light are left out.

    Returns
    -------
    Task

    Raises
    ------
    InvalidInputError
        If a light, shadow, option, plan or budget is out of its domain.
    BudgetError
        If no plan fits the budget.
    """
    choices, budget = _choices(options, wishes, reusable)
    known = costs(budget is not None)  # measured, if it must be, before the clock starts
    stopwatch = Stopwatch()
    # No rung of a ladder has it otherwise; an error about it now, not after shadows were cast.
    denoised = denoising(spec, choices[0][1])
    if mixed:
        light = giving_light(light)
    with stopwatch.stage("prepare"):
        guides = guiding_shadows(scene, light, negative)

    @cache
    def seen_in(mode: WindowMode) -> tuple[Prepared, Facts, str]:
        prepared = prepare_window(spec, scene, guides, mode)
        facts = scene_facts(
            spec, prepared, soft=softness(light), denoised=denoised, reusable=reusable
        )
        return prepared, facts, view_digest(prepared.view)

    quickest = math.inf
    for name, choice in choices:
        with stopwatch.stage("prepare"):
            chosen = choice.for_backbone(spec)
            prepared, facts, view = seen_in(chosen.window)
            key = plain_key(view, chosen, denoised)
            no_shadow = remembered.get(key) if chosen.skip else None
        took = stopwatch.seconds["prepare"]
        facts = replace(facts, remembered=no_shadow is not None, prepared_seconds=took)
        plan = make_plan(facts, chosen, known, name)
        if budget is None or (plan.seconds is not None and plan.seconds <= budget):
            parts = tuple(
                part_of(plan, number, facts, chosen, known) for number in range(len(guides))
            )
            return Task(prepared, chosen, plan, parts, denoised, stopwatch, key, no_shadow)
        quickest = min(quickest, plan.seconds or math.inf)
    raise BudgetError(
        f"budget: expected at least {quickest:.2g} s, which the quickest plan takes for this scene "
        f"on this machine, got {budget:g} s"
    )


def check_wishes(wishes: Wishes, options: RelightOptions | None = None) -> None:
    """Raise what `prepare_task` would raise about options, plan and budget alone.

    Raises
    ------
    InvalidInputError
    """
    _choices(options, wishes, reusable=True)


def _choices(
    options: RelightOptions | None, wishes: Wishes, reusable: bool
) -> tuple[list[tuple[str | None, RelightOptions]], float | None]:
    """Options to choose from, the most accurate first, and the budget to choose by."""
    changes: dict[str, Any] = dict(wishes)
    plan, budget = changes.pop("plan", None), changes.pop("budget", None)
    base = options or RelightOptions()
    if plan is not None and budget is not None:
        raise InvalidInputError(f"plan, budget: expected one of them, got {plan!r} and {budget!r}")
    if plan is not None:
        rung = named_rung(cast("str", plan), reusable)
        return [(rung.name, replace(base, **(rung.options | changes)))], None
    if budget is None:
        return [(None, replace(base, **changes))], None
    if not isinstance(budget, int | float) or not 0.0 < budget < math.inf:
        raise InvalidInputError(f"budget: expected seconds above 0, got {budget!r}")
    rungs = read_ladder(reusable)
    return [(r.name, replace(base, **(r.options | changes))) for r in rungs], budget
