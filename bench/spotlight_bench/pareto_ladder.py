"""The ladder that budgets and named plans climb: rungs on the front, the most accurate first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from spotlight_bench.errors import ResultsError
from spotlight_bench.pareto_grid import EXACT, Candidate
from spotlight_bench.pareto_summary import NEAR, Point, front

__all__ = ["BALANCED_SHARE", "DRAFT_SHARE", "claims", "ladder_record", "name_rungs"]

BALANCED_SHARE: Final = 1 / 4
DRAFT_SHARE: Final = 1 / 12
"""Of the exact plan's time, at most."""
CLOSER: Final = 0.8
"""A rung between the named ones takes at most this share of the time of the one above."""
BALANCED_LOSS, DRAFT_LOSS = 0.1, 0.5
"""PSNR of the object against the truth that may be lost, dB."""
FOLLOWING_LOSS: Final = 2.0
"""Percentage points of light following, within ±45°, that the balanced plan may lose."""


def name_rungs(found: Sequence[Point]) -> tuple[Point, ...]:
    """Name the rungs among points whose front is marked.

    ``balanced`` is the most faithful at a quarter of the exact plan's time or less of those that
    lose no more than it may, ``draft`` at a twelfth; where all lose more, the most faithful, and
    where none is that fast, the fastest. Where both are one point, it stands twice. Where a busy
    clock finds nothing faster than the exact plan, the front is that of the savings alone.

    Parameters
    ----------
    found : sequence of Point
        The exact plan first; those of other models are on no ladder, which knows none.

    Returns
    -------
    tuple of Point
        The rungs: the exact plan, then descending in accuracy.

    Raises
    ------
    ResultsError
        If there is no saving at all.
    """
    own = found[0].candidate.model
    savings = [p for p in found if p.candidate.model == own and p.candidate.options]
    if not savings:
        raise ResultsError("ladder: expected savings, found the exact plan alone")
    others = [p for p in savings if p.front] or [p for p in front(savings) if p.front]
    falling = sorted(others, key=lambda point: (-point.fidelity, point.cost))
    balanced, draft = (
        _best(falling, share, loss)
        for share, loss in ((BALANCED_SHARE, BALANCED_LOSS), (DRAFT_SHARE, DRAFT_LOSS))
    )
    rungs, last = [replace(found[0], rung=EXACT)], found[0].cost
    for point in falling:
        if point in (balanced, draft):
            rungs += [replace(point, rung="balanced")] if point is balanced else []
            rungs += [replace(point, rung="draft")] if point is draft else []
        elif point.cost <= CLOSER * last:
            rungs.append(replace(point, rung=point.candidate.name))
        else:
            continue
        last = point.cost
    return tuple(rungs)


def _best(falling: Sequence[Point], share: float, loss: float) -> Point:
    """See `name_rungs`; ``falling`` in accuracy."""
    quick = [point for point in falling if point.cost <= share] or [falling[-1]]
    kept = (point for point in quick if point.loss_db is not None and point.loss_db <= loss)
    return next(kept, quick[0])


def ladder_record(found: Sequence[Point], measured: dict[str, Any]) -> dict[str, Any]:
    """What `spotlight_runtime.planning.ladder` reads: a ladder, and one for any model.

    Not every model can reuse features, or sees at half of its scale.

    Parameters
    ----------
    found : sequence of Point
        As `name_rungs` takes them.
    measured : dict
        On what: model, scenes.
    """
    whole = front([point for point in found if _for_any(point.candidate)])
    ladders = {"rungs": name_rungs(found), "rungs_without_reuse": name_rungs(whole)}
    return {"measured": measured} | {
        name: [
            {
                "name": point.rung,
                "options": point.candidate.options,
                "loss_db": None if point.loss_db is None else round(point.loss_db, 3) + 0.0,
                "fidelity_db": None if point.rung == EXACT else round(point.fidelity, 2),
            }
            for point in rungs
        ]
        for name, rungs in ladders.items()
    }


def _for_any(candidate: Candidate) -> bool:
    """Whether what it asks for every model can do: not all see at half their scale."""
    return "reuse" not in candidate.options and candidate.options.get("window") != "coarse"


def claims(rungs: Sequence[Point]) -> tuple[tuple[str, bool], ...]:
    """What the named plans are to keep, each with whether they do."""
    by_name = {point.rung: point for point in rungs}
    balanced, draft = by_name["balanced"], by_name["draft"]
    lost = balanced.losses.get(NEAR)
    points = None if lost is None else 100.0 * lost.mean
    checks = [
        ("balanced: time ≤ 1/4 of exact", balanced.cost, BALANCED_SHARE),
        ("balanced: object PSNR lost ≤ 0.1 dB", balanced.loss_db, BALANCED_LOSS),
        ("balanced: light following lost ≤ 2 points", points, FOLLOWING_LOSS),
        ("draft: time ≤ 1/12 of exact", draft.cost, DRAFT_SHARE),
        ("draft: object PSNR lost ≤ 0.5 dB", draft.loss_db, DRAFT_LOSS),
    ]
    return tuple(
        (f"{text} (found {value:.3g})", value <= limit)
        for text, value, limit in checks
        if value is not None
    )
