"""From single pictures' results to figures a method, a task and a region."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from spotlight_bench import following
from spotlight_bench.dataset import AZIMUTHS, DOMINANT
from spotlight_bench.methods import Method
from spotlight_bench.metrics import METRICS, REGIONS, Metric
from spotlight_bench.results import Result
from spotlight_bench.statistics import Estimate, by_scene, estimate

__all__ = ["FOLLOWING", "TASKS", "Figure", "Summary", "summarise"]

Task = Literal["reference-based", "user-controlled"]
TASKS: Final[tuple[Task, ...]] = ("reference-based", "user-controlled")
FOLLOWING: Final = (
    Metric("top_1", "top-1", True, 3),
    Metric("within_45", "within ±45°", True, 3),
    Metric("top_1_offset_free", "top-1, contrast free", True, 3),
    Metric("within_45_offset_free", "within ±45°, contrast free", True, 3),
)
"""Shares in [0, 1] of the user-controlled pictures; see `spotlight_bench.following`."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One cell of a table, with the figure of each scene that it is the mean of."""

    method: str
    task: Task
    region: str
    metric: str
    estimate: Estimate
    scenes: dict[str, float]


@dataclass(frozen=True, slots=True)
class Summary:
    """All figures of an evaluation.

    Attributes
    ----------
    methods : tuple of Method
        In the order of the tables.
    figures : tuple of Figure
        Those there are.
    pictures : dict of int
        Number of pictures by task.
    worst_background_change : dict of float
        By method: largest change of the photograph outside object and shadow.
    evaluations, seconds : dict of float
        Mean of a picture, by method, without the picture that all methods share.
    """

    methods: tuple[Method, ...]
    figures: tuple[Figure, ...]
    pictures: dict[str, int]
    worst_background_change: dict[str, float]
    evaluations: dict[str, float]
    seconds: dict[str, float]

    def figure(self, method: str, task: Task, region: str, metric: str) -> Figure | None:
        """The figure of that cell, or None."""
        wanted = (method, task, region, metric)
        for found in self.figures:
            if (found.method, found.task, found.region, found.metric) == wanted:
                return found
        return None


def summarise(results: Iterable[Result], methods: Sequence[Method]) -> Summary:
    """Figures of these methods, from the results of their present settings."""
    settings = {method.name: method.how for method in methods}
    kept = [r for r in results if settings.get(r.method) == r.how]
    by_method = {m.name: [r for r in kept if r.method == m.name] for m in methods}
    figures: list[Figure] = []
    for name, own in by_method.items():
        for task in TASKS:
            of_task = [r for r in own if _task(r) == task]
            figures += _metric_figures(name, task, of_task)
            figures += _following_figures(name, task, of_task)
    changes = {
        name: [r.background_change for r in own if r.background_change is not None]
        for name, own in by_method.items()
    }
    made = {name: own for name, own in by_method.items() if own}
    return Summary(
        tuple(methods),
        tuple(figures),
        {task: len({r.key[:2] for r in kept if _task(r) == task}) for task in TASKS},
        {name: max(found) for name, found in changes.items() if found},
        {name: float(np.mean([r.evaluations for r in own])) for name, own in made.items()},
        {name: float(np.mean([r.seconds for r in own])) for name, own in made.items()},
    )


def _task(result: Result) -> Task:
    return "reference-based" if result.direction == DOMINANT else "user-controlled"


def _metric_figures(method: str, task: Task, results: Sequence[Result]) -> list[Figure]:
    found = []
    for region in REGIONS:
        for metric in METRICS:
            values = [
                (r.scene, r.scores[region][metric.name]) for r in results if region in r.scores
            ]
            found += _figure(method, task, region, metric.name, values)
    return found


def _following_figures(method: str, task: Task, results: Sequence[Result]) -> list[Figure]:
    tests: dict[str, Callable[[Sequence[float], int], bool]] = {
        "top_1": following.is_right,
        "within_45": following.is_near,
    }
    found = []
    for metric in FOLLOWING:
        test = tests[metric.name.removesuffix("_offset_free")]
        free = metric.name.endswith("_offset_free")
        values = []
        for result in results:
            distances = result.following_offset_free if free else result.following
            if distances:
                right = test(distances, AZIMUTHS.index(result.direction))
                values.append((result.scene, float(right)))
        found += _figure(method, task, "foreground", metric.name, values)
    return found


def _figure(
    method: str, task: Task, region: str, metric: str, values: Sequence[tuple[str, float | None]]
) -> list[Figure]:
    scenes = by_scene(values)
    found = estimate(scenes)
    return [] if found is None else [Figure(method, task, region, metric, found, scenes)]
