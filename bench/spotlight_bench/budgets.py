"""``spotlight-bench budgets``: how far what plans predict is from what relights take.

Requests are drawn at random, seeded: a scene, one to three lights, options or a named plan or a
budget. Each is planned and run; nothing is remembered from one to the next.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, cast, get_args

import numpy as np
import typer

from spotlight_bench import arguments as a
from spotlight_runtime.planning.ladder import PlanName

if TYPE_CHECKING:
    from spotlight_bench.dataset import TestScene
    from spotlight_runtime import Relighter

__all__ = ["Outcome", "Request", "budgets", "draw", "outcomes", "summary"]

REQUESTS: Final = 100
WITHIN: Final = 0.2
"""Of the predicted seconds: the tolerance of a prediction."""
WANTED_SHARE: Final = 0.9
WORST_OVERRUN: Final = 0.3
"""A budget may be exceeded by at most this share of it."""
MOST_LIGHTS: Final = 3
BUDGET_RANGE: Final = (0.05, 1.2)
"""Budgets, as shares of what the exact plan of the same request is predicted to take."""
KINDS: Final = ("budget", "plan", "options")
KIND_CHANCES: Final = (0.5, 0.25, 0.25)
PIPED_WIDTH: Final = 120


@dataclass(frozen=True, slots=True)
class Request:
    """Something to relight, and how.

    Attributes
    ----------
    scene : str
    lights : tuple of str
        Directions of the scene.
    kind : {"budget", "plan", "options"}
    wishes : dict
        Keywords of `Relighter.relight`; a budget still as a share of the exact plan's seconds.
    """

    scene: str
    lights: tuple[str, ...]
    kind: str
    wishes: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Outcome:
    """A request, run.

    Attributes
    ----------
    request : Request
    plan : str
        Name of the plan that ran; ``refused`` where none fits the budget.
    predicted, actual, budget : float or None
        Seconds.
    """

    request: Request
    plan: str
    predicted: float | None
    actual: float | None
    budget: float | None

    @property
    def error(self) -> float | None:
        """By how much the relight took longer than predicted, as a share of that."""
        if self.predicted is None or self.actual is None:
            return None
        return self.actual / self.predicted - 1.0

    @property
    def overrun(self) -> float | None:
        """By how much it exceeded its budget, as a share of that; below 0 where it kept to it."""
        if self.budget is None or self.actual is None:
            return None
        return self.actual / self.budget - 1.0


def draw(count: int, scenes: Sequence[str], lights: Sequence[str], seed: int) -> list[Request]:
    """Draw requests.

    Parameters
    ----------
    count : int
    scenes, lights : sequence of str
        To draw from.
    seed : int
    """
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        number = int(rng.integers(1, min(MOST_LIGHTS, len(lights)) + 1))
        picked = tuple(str(name) for name in rng.choice(lights, number, replace=False))
        kind = str(rng.choice(KINDS, p=KIND_CHANCES))
        wishes: dict[str, Any] = {"seed": int(rng.integers(2**31))}
        if kind == "budget":
            low, high = np.log(BUDGET_RANGE)
            wishes["budget"] = float(np.exp(rng.uniform(low, high)))
        elif kind == "plan":
            wishes["plan"] = str(rng.choice(get_args(PlanName)))
        else:
            wishes["steps"] = int(rng.integers(2, 21))
            wishes["solver"] = str(rng.choice(["ddim", "dpmpp_2m", "unipc"]))
            wishes["gamma"] = float(rng.choice([1.0, 3.0, 7.0]))
            wishes["beta"] = float(rng.choice([0.0, 0.05]))
            wishes["guidance_interval"] = (0.0, float(rng.choice([0.5, 1.0])))
            wishes["window"] = str(rng.choice(["auto", "tight"]))
        found.append(Request(str(rng.choice(scenes)), picked, kind, wishes))
    return found


def outcomes(
    relighter: Relighter, scenes: dict[str, TestScene], requests: Sequence[Request]
) -> Iterator[Outcome]:
    """Plan and run each request, yielding after each.

    Parameters
    ----------
    relighter : Relighter
        Remembering nothing; it is calibrated first.
    scenes : dict of TestScene
        By name.
    requests : sequence of Request
    """
    from spotlight_bench.pareto import guide_of
    from spotlight_runtime.errors import BudgetError

    relighter.calibrated()
    for request in requests:
        test = scenes[request.scene]
        known = {direction.name: direction for direction in test.directions}
        guides = [guide_of(known[name]) for name in request.lights]
        wishes = dict(request.wishes)
        budget = None
        if request.kind == "budget":
            whole = relighter.plan(test.scene, guides).seconds
            wishes["budget"] = budget = wishes["budget"] * cast("float", whole)
        start = time.perf_counter()
        try:
            result = relighter.relight(test.scene, guides, **wishes)
        except BudgetError:
            yield Outcome(request, "refused", None, None, budget)
            continue
        actual = time.perf_counter() - start
        yield Outcome(request, result.plan.name, result.plan.seconds, actual, budget)


def summary(found: Sequence[Outcome]) -> dict[str, Any]:
    """Shares and extremes of all outcomes, and whether they are what is wanted."""
    errors = np.array([one.error for one in found if one.error is not None])
    overruns = [one.overrun for one in found if one.overrun is not None]
    within = float(np.mean(np.abs(errors) <= WITHIN)) if errors.size else None
    worst = max(overruns, default=None)
    return {
        "requests": len(found),
        "refused": sum(one.plan == "refused" for one in found),
        "within_20_percent": within,
        "median_error": float(np.median(errors)) if errors.size else None,
        "largest_error": float(errors[np.abs(errors).argmax()]) if errors.size else None,
        "worst_overrun": worst,
        "predictions_hold": within is not None and within >= WANTED_SHARE,
        "budgets_hold": worst is None or worst <= WORST_OVERRUN,
    }


def budgets(
    data: Annotated[
        Path, typer.Argument(metavar="TESTSET", help="Test set: a folder a scene.")
    ] = Path("testset"),
    model: Annotated[str, typer.Option(help="Model name or folder.")] = "mini",
    requests: Annotated[int, typer.Option(min=1, help="Requests.")] = REQUESTS,
    scenes: Annotated[int, typer.Option(min=1, help="Scenes to draw from, at most.")] = 20,
    seed: Annotated[int, typer.Option(help="Of the requests.")] = 0,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write every request and its times here.")
    ] = None,
    threads: a.Threads = None,
) -> None:
    """Hold the seconds that plans predict against those that relights take.

    Example: spotlight-bench budgets testset --requests 100
    """
    from rich.console import Console
    from rich.progress import track

    from spotlight_bench.dataset import AZIMUTHS, azimuth_scenes
    from spotlight_runtime import Relighter
    from spotlight_spec import write_json

    known = {test.name: test for test in azimuth_scenes(data, scenes)}
    relighter = Relighter.load(model, threads=threads, remember=0)
    drawn = draw(requests, list(known), AZIMUTHS, seed)
    run = track(
        outcomes(relighter, known, drawn), "requests", requests, console=Console(stderr=True)
    )
    found = list(run)
    facts = summary(found)
    if json_file is not None:
        write_json(json_file, {"summary": facts, "outcomes": [_record(one) for one in found]})
    console = Console(width=None if sys.stdout.isatty() else PIPED_WIDTH)
    console.print(_table(found))
    for name, value in facts.items():
        console.print(f"{name.replace('_', ' ')}: {_shown(value)}")


def _record(one: Outcome) -> dict[str, Any]:
    return asdict(one) | {"error": one.error, "overrun": one.overrun}


def _table(found: Sequence[Outcome]) -> Any:
    """By what was asked and what ran: how many, and how far off."""
    from rich.table import Table

    table = Table(title="Predicted against actual seconds", title_justify="left")
    for name in ("asked", "ran", "requests", "within 20 %", "median error", "worst overrun"):
        table.add_column(name, justify="left" if name in ("asked", "ran") else "right")
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for one in found:
        groups.setdefault((one.request.kind, one.plan), []).append(one)
    for (kind, plan), group in sorted(groups.items()):
        facts = summary(group)
        cells = [facts[name] for name in ("within_20_percent", "median_error", "worst_overrun")]
        shown = ("–" if value is None else f"{100 * value:.0f} %" for value in cells)
        table.add_row(kind, plan, str(len(group)), *shown)
    return table


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
