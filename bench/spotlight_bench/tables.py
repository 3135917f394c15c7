"""The tables of an evaluation: on the terminal, as Markdown, as CSV and as JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from rich.table import Table

from spotlight_bench.claims import Claim
from spotlight_bench.metrics import METRICS, REGIONS, Metric
from spotlight_bench.results import Result
from spotlight_bench.statistics import Estimate
from spotlight_bench.summary import FOLLOWING, TASKS, Summary, Task

__all__ = [
    "Grid",
    "as_json",
    "as_markdown",
    "as_rich",
    "grids",
    "images_csv",
    "methods_csv",
]

NOTES: Final = """\
Means over scenes (a scene's directions averaged first) with 95 % bootstrap intervals over scenes.
PSNR in dB of sRGB-encoded 8-bit pictures; a picture's PSNR, RMSE and MAE are taken first, then the
mean. Foreground: pixels that the object covers by half or more; background: the others. SSIM,
ST-LPIPS and ꟻLIP of a region are means over it of their maps, with the truth put outside it. Light
following: share of pictures whose shading on the object is nearest, among the truths of all eight
lights, to that of the wanted light, or to it or one beside it, up to a scale; *contrast free*: up
to scale and offset. Seconds and evaluations leave out the picture without a shadow, which methods
share; but a plan of fewer steps has one of its own, and the seconds of it."""


@dataclass(frozen=True, slots=True)
class Grid:
    """One table: a title, headings, and a row of estimates a method.

    Attributes
    ----------
    title : str
    columns : tuple of Metric
    rows : tuple of (str, tuple of Estimate or None)
        Label of the method, and its cells.
    """

    title: str
    columns: tuple[Metric, ...]
    rows: tuple[tuple[str, tuple[Estimate | None, ...]], ...]

    def best(self, column: int) -> float | None:
        """The best mean of a column, as it is printed."""
        metric = self.columns[column]
        found = [row[column] for _, row in self.rows]
        means = [round(cell.mean, metric.digits) for cell in found if cell is not None]
        if not means:
            return None
        return max(means) if metric.higher_is_better else min(means)


def grids(summary: Summary) -> Iterator[Grid]:
    """Tables that have something in them: the whole picture first, then its regions."""
    for task in TASKS:
        for region in REGIONS:
            grid = _grid(summary, task, region, METRICS)
            if grid is not None:
                yield grid
        grid = _grid(summary, task, "foreground", FOLLOWING)
        if grid is not None:
            yield grid


def as_rich(grid: Grid) -> Table:
    """For the terminal: mean and half the interval's width, the best in bold."""
    table = Table(title=grid.title, title_justify="left", title_style="bold")
    table.add_column("method")
    for metric in grid.columns:
        table.add_column(metric.heading, justify="right", no_wrap=True)
    for label, cells in grid.rows:
        table.add_row(label, *(_short(grid, i, cell) for i, cell in enumerate(cells)))
    return table


def as_markdown(summary: Summary, claims: Sequence[Claim], settings: dict[str, Any]) -> str:
    """The whole report."""
    lines = ["# Evaluation", "", *(f"* {name}: {value}" for name, value in settings.items())]
    lines += ["", NOTES, ""]
    for grid in grids(summary):
        lines += [f"## {grid.title}", ""]
        lines.append("| method | " + " | ".join(m.heading for m in grid.columns) + " |")
        lines.append("|---|" + "---|" * len(grid.columns))
        for label, cells in grid.rows:
            told = (_long(grid, i, cell) for i, cell in enumerate(cells))
            lines.append(f"| {label} | " + " | ".join(told) + " |")
        lines.append("")
    if claims:
        lines += ["## Claims", "", "| claim | found | holds |", "|---|---|---|"]
        lines += [f"| {c.text} | {c.found} | {'yes' if c.holds else '**no**'} |" for c in claims]
        lines.append("")
    lines += ["## Cost", "", "| method | evaluations a picture | seconds |", "|---|---|---|"]
    for method in summary.methods:
        if method.name in summary.seconds:
            evaluations, seconds = (
                summary.evaluations[method.name],
                summary.seconds[method.name],
            )
            lines.append(f"| {method.label} | {evaluations:g} | {seconds:.2f} |")
    return "\n".join(lines) + "\n"


def images_csv(results: Iterable[Result]) -> str:
    """One line a picture."""
    names = [f"{region}_{metric.name}" for region in REGIONS for metric in METRICS]
    heading = ["scene", "direction", "method", "setting", *names]
    heading += [f"distance_{index:04d}" for index in range(8)]
    heading += ["background_change", "evaluations", "seconds"]
    rows = []
    for r in sorted(results, key=lambda result: result.key):
        scores = [
            r.scores.get(region, {}).get(metric.name) for region in REGIONS for metric in METRICS
        ]
        distances = [*r.following, *[None] * (8 - len(r.following))]
        rows.append(
            [r.scene, r.direction, r.method, r.how]
            + [_number(value) for value in (*scores, *distances, r.background_change)]
            + [str(r.evaluations), f"{r.seconds:.4f}"]
        )
    return _csv(heading, rows)


def methods_csv(summary: Summary) -> str:
    """One line a method, task, region and metric."""
    heading = ["method", "task", "region", "metric", "mean", "low", "high", "scenes"]
    rows = [
        [f.method, f.task, f.region, f.metric]
        + [_number(value) for value in (f.estimate.mean, f.estimate.low, f.estimate.high)]
        + [str(f.estimate.scenes)]
        for f in summary.figures
    ]
    return _csv(heading, rows)


def as_json(summary: Summary, claims: Sequence[Claim], settings: dict[str, Any]) -> dict[str, Any]:
    """Everything in the report, for machines."""
    return {
        "settings": settings,
        "pictures": summary.pictures,
        "methods": {method.name: method.how for method in summary.methods},
        "figures": [
            {
                "method": f.method,
                "task": f.task,
                "region": f.region,
                "metric": f.metric,
                **asdict(f.estimate),
            }
            for f in summary.figures
        ],
        "worst_background_change": summary.worst_background_change,
        "evaluations": summary.evaluations,
        "seconds": summary.seconds,
        "claims": [asdict(claim) for claim in claims],
    }


def _grid(summary: Summary, task: Task, region: str, columns: tuple[Metric, ...]) -> Grid | None:
    rows = []
    for method in summary.methods:
        found = [summary.figure(method.name, task, region, metric.name) for metric in columns]
        if any(found):
            rows.append((method.label, tuple(f.estimate if f else None for f in found)))
    if not rows:
        return None
    shown = "light following" if columns is FOLLOWING else region
    shown = "full image" if shown == "full" else shown
    title = f"{task.capitalize()}, {shown} ({summary.pictures[task]} pictures a method)"
    return Grid(title, columns, tuple(rows))


def _short(grid: Grid, column: int, cell: Estimate | None) -> str:
    if cell is None:
        return "–"
    digits = grid.columns[column].digits
    half = (cell.high - cell.low) / 2
    text = f"{cell.mean:.{digits}f} ±{half:.{digits}f}"
    return f"[bold]{text}[/bold]" if _is_best(grid, column, cell) else text


def _long(grid: Grid, column: int, cell: Estimate | None) -> str:
    if cell is None:
        return "–"
    digits = grid.columns[column].digits
    mean = f"{cell.mean:.{digits}f}"
    mean = f"**{mean}**" if _is_best(grid, column, cell) else mean
    return f"{mean} [{cell.low:.{digits}f}, {cell.high:.{digits}f}]"


def _is_best(grid: Grid, column: int, cell: Estimate) -> bool:
    return round(cell.mean, grid.columns[column].digits) == grid.best(column)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def _csv(heading: list[str], rows: Iterable[list[str]]) -> str:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows(rows)
    return file.getvalue()
