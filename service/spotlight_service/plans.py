"""Where plans and time budgets meet the service; nothing else here knows of planning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, get_args

from spotlight_runtime import Light, Progress, Relighter, Scene
from spotlight_runtime.cli.demo import find_scene
from spotlight_runtime.planning.ladder import PlanName, Rung, named_rung
from spotlight_runtime.planning.options import WindowMode
from spotlight_runtime.relighting.tasks import Task, Wishes, check_wishes

__all__ = [
    "PlanName",
    "check_plan",
    "evaluations_at",
    "evaluations_of",
    "offered",
    "plan_report",
    "predicted",
    "prepared",
    "together_of",
]

USUAL: Final = "exact"
_LIGHT: Final = Light(azimuth=135.0, elevation=45.0)
"""Of what plans are predicted for: a scene that comes along, and one light."""
_WINDOWS: Final[dict[WindowMode, str]] = {
    "tight": "only about object and shadow",
    "coarse": "only about object and shadow, at a coarser scale",
}


def check_plan(request: Mapping[str, Any]) -> None:
    """Raise where options, plan or budget are out of their domain.

    Parameters
    ----------
    request : mapping
        With ``options``, ``plan`` and ``budget_s``, as jobs have them.

    Raises
    ------
    InvalidInputError
    """
    check_wishes(_wishes(request))


def prepared(
    relighter: Relighter, scene: Scene, guides: Any, negative: Any, request: Mapping[str, Any]
) -> Task:
    """Make a relight ready to run, after the plan or the budget it asks for.

    Raises
    ------
    SpotLightError
        See `Relighter.prepare`.
    """
    mixed = not request["sweep"]
    return relighter.prepare(scene, guides, negative, mixed=mixed, **_wishes(request))


def plan_report(task: Task) -> dict[str, Any]:
    """What will be run, and why; and the window: left, top, right, bottom in fractions."""
    window = task.prepared.window
    height, width = window.frame
    corners = (window.left, window.top, window.left + window.width, window.top + window.height)
    shares = [round(at / of, 5) for at, of in zip(corners, (width, height) * 2)]
    return {**task.plan.report(), "window": shares}


def evaluations_of(task: Task) -> int:
    """Denoiser evaluations that a relight takes."""
    return task.plan.evaluations


def evaluations_at(task: Task, progress: Progress) -> int:
    """Denoiser evaluations that one step of it took."""
    if progress.stage == "no shadow":
        return 1
    return task.plan.passes[progress.light].branches_at(progress.step.index)


def together_of(task: Task) -> list[list[int]]:
    """By light, those that go through the network together with it."""
    return [list(lights) for lights in task.plan.together for _ in lights]


def predicted(relighter: Relighter) -> dict[str, float]:
    """Seconds that each plan takes on this machine, for a small scene and one light."""
    scene = Scene.load(find_scene(None))
    relighter.calibrated()
    found = {name: relighter.plan(scene, _LIGHT, plan=name) for name in get_args(PlanName)}
    return {name: round(plan.seconds or 0.0, 3) for name, plan in found.items()}


def offered(seconds: Mapping[str, float], reusable: bool) -> list[dict[str, Any]]:
    """The plans there are: what each leaves out, what it takes here, and what it costs.

    Parameters
    ----------
    seconds : mapping of str to float
        As `predicted` says; empty where nothing has been measured yet.
    reusable : bool
        Whether the model can reuse deep features between steps.
    """
    return [
        {
            "name": name,
            "summary": _summary(named_rung(name, reusable)),
            "seconds": seconds.get(name),
            "loss_db": named_rung(name, reusable).loss_db,
        }
        for name in get_args(PlanName)
    ]


def _summary(rung: Rung) -> str:
    """What a plan does, in half a line, from the options it stands for."""
    options = rung.options
    if not options:
        return "every effect the scene calls for; what could not change the picture is left out"
    said = [f"{options['steps']} steps of {options.get('solver', 'ddim')}"]
    if "plain_steps" in options:
        said.append(f"{options['plain_steps']} without shadow")
    if "guidance_interval" in options:
        first, last = options["guidance_interval"]
        said.append(f"guidance from {first:.0%} to {last:.0%} of them")
    if "reuse" in options:
        said.append(f"the whole network in one of {options['reuse']}")
    if "window" in options:
        said.append(_WINDOWS[options["window"]])
    return ", ".join(said)


def _wishes(request: Mapping[str, Any]) -> Wishes:
    wishes: dict[str, Any] = dict(request["options"])
    if request["plan"] is not None or request["budget_s"] is None:
        wishes["plan"] = request["plan"] or USUAL
    if request["budget_s"] is not None:
        wishes["budget"] = request["budget_s"]
    return wishes  # type: ignore[return-value]
