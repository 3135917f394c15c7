"""What the sweep found: a point a candidate, and the Pareto front."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from spotlight_bench import following
from spotlight_bench.dataset import AZIMUTHS
from spotlight_bench.metrics import BEST_PSNR
from spotlight_bench.pareto_grid import EXACT, Candidate
from spotlight_bench.pareto_timing import Timing
from spotlight_bench.results import Result
from spotlight_bench.statistics import Estimate, by_scene, difference, estimate

__all__ = ["FIGURES", "Figure", "Point", "front", "points", "survivors"]

Values = dict[str, float]


@dataclass(frozen=True, slots=True)
class Figure:
    """A measure of accuracy.

    Attributes
    ----------
    name, label : str
    higher_is_better : bool
    scale : float
        By which it is multiplied for people: 100 for shares.
    digits : int
    of : callable
        Its value of one picture, None where it has none.
    """

    name: str
    label: str
    higher_is_better: bool
    of: Callable[[Result], float | None]
    scale: float = 1.0
    digits: int = 2


def _score(kind: str, name: str) -> Callable[[Result], float | None]:
    return lambda result: result.scores.get(kind, {}).get(name)


def _follows(test: Callable[[Sequence[float], int], bool]) -> Callable[[Result], float | None]:
    def of(result: Result) -> float | None:
        if not result.following:
            return None
        return float(test(result.following, AZIMUTHS.index(result.direction)))

    return of


OBJECT, REST, NEAR = "object_psnr", "rest_psnr", "within_45"
SAME_OBJECT, SAME_REST = "exact_object_psnr", "exact_rest_psnr"
FIGURES: Final = (
    Figure(OBJECT, "object PSNR", True, _score("truth", "foreground_psnr")),
    Figure(REST, "rest PSNR", True, _score("truth", "background_psnr")),
    Figure("st_lpips", "ST-LPIPS", False, _score("truth", "foreground_st_lpips"), digits=4),
    Figure(NEAR, "within ±45°", True, _follows(following.is_near), 100.0, 1),
    Figure("top_1", "top-1", True, _follows(following.is_right), 100.0, 1),
    Figure(SAME_OBJECT, "object, of exact", True, _score("exact", "foreground_psnr")),
    Figure(SAME_REST, "rest, of exact", True, _score("exact", "background_psnr")),
    Figure(
        "exact_st_lpips", "ST-LPIPS, of exact", False, _score("exact", "foreground_st_lpips"),
        digits=4,
    ),
)  # fmt: skip
MARGIN_DB: Final = 0.5
"""A candidate this near the front after the screening goes on to all scenes."""


@dataclass(frozen=True, slots=True)
class Point:
    """What a candidate costs and how accurate it is.

    Attributes
    ----------
    candidate : Candidate
    evaluations : float
        Of the denoiser, mean.
    predicted_share : float
        Of the exact plan's time, as the plans predict it.
    accuracy : dict of Estimate
        By figure; means over scenes with intervals.
    losses : dict of Estimate
        By figure that is held against the truth: what is lost against the exact plan, paired by
        scene; positive is worse, whichever way the figure points.
    seconds, share : float or None
        Medians by the clock, and as a share of the exact plan's of the same round.
    peak_memory_bytes : int or None
    front : bool
        Whether no other is both faster and more accurate.
    rung : str
        Its name on the ladder; empty where it has none.
    """

    candidate: Candidate
    evaluations: float
    predicted_share: float
    accuracy: dict[str, Estimate]
    losses: dict[str, Estimate]
    seconds: float | None = None
    share: float | None = None
    peak_memory_bytes: int | None = None
    front: bool = False
    rung: str = ""

    @property
    def fidelity(self) -> float:
        """PSNR against the exact plan's picture, of the object or the rest, the lower one, dB.

        This is what the front and the ladder go by. PSNR against the truth is not: fewer steps
        and less guidance give a blurrier object, which it rewards, while the light is no longer
        followed.
        """
        found = [self.accuracy.get(name) for name in (SAME_OBJECT, SAME_REST)]
        return min((one.mean for one in found if one is not None), default=BEST_PSNR)

    @property
    def loss_db(self) -> float | None:
        """PSNR of the object lost against the truth; below 0 where it gained."""
        found = self.losses.get(OBJECT)
        return None if found is None else found.mean

    @property
    def cost(self) -> float:
        """Its share of the exact plan's time, measured or else predicted."""
        return self.predicted_share if self.share is None else self.share


def points(
    results: Iterable[Result],
    candidates: Sequence[Candidate],
    timings: Iterable[Timing] = (),
    memory: Mapping[str, int | None] | None = None,
) -> tuple[Point, ...]:
    """One point a candidate that has results, over the pictures the exact plan has as well.

    Parameters
    ----------
    results : iterable of Result
    candidates : sequence of Candidate
        The exact plan first.
    timings : iterable of Timing
    memory : mapping of str to int or None, optional
        Peak bytes by candidate.
    """
    by_name: dict[str, list[Result]] = {}
    for result in results:
        by_name.setdefault(result.method, []).append(result)
    exact = _figures(by_name[EXACT])
    seconds, shares = _times(timings)
    found = []
    for candidate in candidates:
        own = by_name.get(candidate.name)
        if own is None:
            continue
        values = _figures(own)
        accuracy = {name: estimate(of) for name, of in values.items()}
        losses = {
            figure.name: _loss(figure, exact[figure.name], values[figure.name])
            for figure in FIGURES
            if not figure.name.startswith("exact")
        }
        found.append(
            Point(
                candidate,
                float(np.mean([result.evaluations for result in own])),
                _predicted(own) / _predicted(by_name[EXACT]),
                {name: value for name, value in accuracy.items() if value is not None},
                {name: value for name, value in losses.items() if value is not None},
                seconds.get(candidate.name),
                shares.get(candidate.name),
                (memory or {}).get(candidate.name),
            )
        )
    return tuple(found)


def front(found: Sequence[Point]) -> tuple[Point, ...]:
    """The same, with those marked that no other beats in both time and fidelity."""
    return tuple(
        replace(point, front=not any(_beats(other, point) for other in found)) for point in found
    )


def survivors(found: Sequence[Point], margin: float = MARGIN_DB) -> tuple[Candidate, ...]:
    """Candidates on the front or within a margin of it, and the exact plan of every model."""
    kept = []
    for point in found:
        best = max(other.fidelity for other in found if other.cost <= point.cost)
        if not point.candidate.options or point.fidelity >= best - margin:
            kept.append(point.candidate)
    return tuple(kept)


def _beats(one: Point, other: Point) -> bool:
    no_worse = one.cost <= other.cost and one.fidelity >= other.fidelity
    return no_worse and (one.cost < other.cost or one.fidelity > other.fidelity)


def _predicted(results: Sequence[Result]) -> float:
    return float(np.mean([result.seconds for result in results]))


def _figures(results: Sequence[Result]) -> dict[str, Values]:
    return {
        figure.name: by_scene([(result.scene, figure.of(result)) for result in results])
        for figure in FIGURES
    }


def _loss(figure: Figure, exact: Values, own: Values) -> Estimate | None:
    pair = (exact, own) if figure.higher_is_better else (own, exact)
    return difference(*pair)


def _times(timings: Iterable[Timing]) -> tuple[Values, Values]:
    """Median seconds, and median share of the exact plan's seconds, by candidate."""
    rounds: dict[int, Values] = {}
    for timing in timings:
        rounds.setdefault(timing.round, {})[timing.candidate] = timing.seconds
    names = {name for each in rounds.values() for name in each}
    seconds, shares = {}, {}
    for name in names:
        shared = [each for each in rounds.values() if name in each and EXACT in each]
        if shared:
            seconds[name] = float(np.median([each[name] for each in shared]))
            shares[name] = float(np.median([each[name] / each[EXACT] for each in shared]))
    return seconds, shares
