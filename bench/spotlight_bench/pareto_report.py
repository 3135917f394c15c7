"""The curve as files and on the terminal: CSV, JSON, Markdown."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table

from spotlight_bench.pareto_summary import FIGURES, Point
from spotlight_bench.pareto_timing import Timing

__all__ = ["as_csv", "as_json", "as_markdown", "as_rich"]

SHOWN = ("exact_object_psnr", "exact_rest_psnr", "object_psnr", "st_lpips", "within_45")


def as_csv(found: Sequence[Point]) -> str:
    """One line a candidate, with every figure's mean and interval, and what is lost."""
    heading = ["candidate", "model", "options", "rung", "front", "evaluations", "seconds"]
    heading += ["share", "predicted_share", "peak_memory_bytes", "fidelity_db"]
    for figure in FIGURES:
        heading += [f"{figure.name}{end}" for end in ("", "_low", "_high")]
    lossy = [figure.name for figure in FIGURES if not figure.name.startswith("exact")]
    for name in lossy:
        heading += [f"lost_{name}{end}" for end in ("", "_low", "_high")]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(heading)
    for point in found:
        row: list[Any] = [point.candidate.name, point.candidate.model]
        row += [json.dumps(point.candidate.options), point.rung, int(point.front)]
        row += [_number(point.evaluations), _number(point.seconds), _number(point.share)]
        row += [_number(point.predicted_share), point.peak_memory_bytes or ""]
        row += [_number(point.fidelity)]
        for known, names in (
            (point.accuracy, [figure.name for figure in FIGURES]),
            (point.losses, lossy),
        ):
            for name in names:
                one = known.get(name)
                values = (None,) * 3 if one is None else (one.mean, one.low, one.high)
                row += [_number(value) for value in values]
        writer.writerow(row)
    return file.getvalue()


def as_json(
    found: Sequence[Point],
    timings: Sequence[Timing],
    claims: Sequence[tuple[str, bool]],
    settings: dict[str, Any],
) -> dict[str, Any]:
    """Everything, for machines."""
    return {
        "settings": settings,
        "points": [
            asdict(point) | {"fidelity_db": point.fidelity, "cost": point.cost} for point in found
        ],
        "claims": [{"text": text, "holds": holds} for text, holds in claims],
        "timings": [asdict(timing) for timing in timings],
    }


def as_markdown(
    rungs: Sequence[Point], claims: Sequence[tuple[str, bool]], settings: dict[str, Any]
) -> str:
    """The table of the ladder."""
    lines = ["# Accuracy over time", "", *(f"* {key}: {value}" for key, value in settings.items())]
    heading = _heading()
    lines += ["", "| " + " | ".join(heading) + " |", "|---" * len(heading) + "|"]
    lines += ["| " + " | ".join(_row(point)) + " |" for point in rungs]
    lines += ["", "| claim | holds |", "|---|---|"]
    lines += [f"| {text} | {'yes' if holds else '**no**'} |" for text, holds in claims]
    return "\n".join(lines) + "\n"


def as_rich(rungs: Sequence[Point]) -> Table:
    """The same on the terminal."""
    first, *others = _heading()
    table = Table(title="The ladder", title_justify="left", title_style="bold")
    table.add_column(first)
    for name in others:
        table.add_column(name, justify="right")
    for point in rungs:
        table.add_row(*_row(point))
    return table


def _heading() -> list[str]:
    labels = {figure.name: figure.label for figure in FIGURES}
    costs = ["plan", "what it is", "evaluations", "seconds", "of exact's time", "peak MB"]
    return [*costs, *(labels[name] for name in SHOWN), "object PSNR lost"]


def _row(point: Point) -> list[str]:
    memory = point.peak_memory_bytes
    row = [point.rung, point.candidate.name, f"{point.evaluations:g}"]
    row += ["–" if point.seconds is None else f"{point.seconds:.2f}"]
    row += [f"{100 * point.cost:.1f} %", "–" if memory is None else f"{memory / 1e6:.0f}"]
    by_name = {figure.name: figure for figure in FIGURES}
    for name in SHOWN:
        found, figure = point.accuracy.get(name), by_name[name]
        shown = "–" if found is None else f"{figure.scale * found.mean:.{figure.digits}f}"
        row.append(shown)
    lost = point.losses.get("object_psnr")
    interval = "" if lost is None else f"{lost.mean:+.2f} [{lost.low:+.2f}, {lost.high:+.2f}]"
    return [*row, interval]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
