"""Where plans and time budgets meet the service; nothing else here knows of planning."""

from __future__ import annotations

from typing import Any, Final, get_args

from spotlight_runtime import Progress, RelightOptions
from spotlight_service.problems import FieldError
from spotlight_service.schemas import PlanName

__all__ = ["check_plan", "evaluations_at", "evaluations_of", "offered", "plan_report", "planned"]

SUPPORTED: Final = ("exact",)
WHAT: Final = {
    "exact": "every effect the scene calls for; what could not change the picture is left out",
}


def check_plan(plan: PlanName | None, budget_s: float | None) -> None:
    """Raise where this service cannot keep to the plan or the budget.

    Raises
    ------
    FieldError
    """
    if plan is not None and budget_s is not None:
        raise FieldError("budget_s", "a plan or a budget", "both", advice="leave one out")
    if budget_s is not None:
        raise FieldError("budget_s", "nothing: plans only, as yet", budget_s, advice="name a plan")
    if plan is not None and plan not in SUPPORTED:
        raise FieldError("plan", f"one of {', '.join(SUPPORTED)}", plan)


def planned(
    options: RelightOptions, plan: PlanName | None, budget_s: float | None
) -> RelightOptions:
    """The options a plan or a budget stands for.

    Parameters
    ----------
    options : RelightOptions
        As the request says.
    plan : {"exact", "balanced", "draft"}, optional
    budget_s : float, optional
        Seconds.
    """
    check_plan(plan, budget_s)
    return options


def plan_report(task: Any) -> dict[str, Any]:
    """What will be run, of a prepared task."""
    report: dict[str, Any] = task.plan.report()
    return report


def evaluations_of(task: Any) -> int:
    """Denoiser evaluations that a prepared task takes."""
    return int(task.plan.evaluations)


def evaluations_at(task: Any, progress: Progress) -> int:
    """Denoiser evaluations that one step of it took."""
    if progress.stage == "no shadow":
        return 1
    return int(task.plan.passes[progress.light].branches_at(progress.step.index))


def offered(seconds: float) -> list[dict[str, Any]]:
    """The plans there are, with the seconds each lately took on this machine."""
    return [
        {"name": name, "summary": WHAT[name], "seconds": round(seconds, 3)}
        for name in get_args(PlanName)
        if name in SUPPORTED
    ]
