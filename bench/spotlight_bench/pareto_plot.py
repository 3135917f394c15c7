"""The curve as a picture a person can read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from spotlight_bench.pareto_grid import EXACT
from spotlight_bench.pareto_summary import Point

__all__ = ["plot"]

COLOURS: Final = {"ddim": "#7a8ba6", "dpmpp_2m": "#c08a3e", "unipc": "#3c7d5a"}
OTHER: Final = "#9467bd"
FRONT: Final = "#b0303a"
NAMED: Final = ("balanced", "draft")
SIZE: Final = (9.0, 5.5)
ROOM: Final = 0.7
"""Of the shortest time: where the axis begins, so that the draft's name has room."""
DOTS: Final = 140
"""Per inch of the PNG."""


def plot(found: Sequence[Point], rungs: Sequence[Point], files: Sequence[Path], what: str) -> None:
    """Draw accuracy over time, the front a line, the named plans by their names.

    Parameters
    ----------
    found : sequence of Point
        Candidates; the exact plan is drawn as the time that all others are a share of.
    rungs : sequence of Point
        See `spotlight_bench.pareto_ladder.name_rungs`.
    files : sequence of Path
        Their suffixes say how.
    what : str
        The title's end: on what it was measured.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, NullFormatter

    figure = Figure(figsize=SIZE, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    savings = [point for point in found if point.candidate.name != EXACT]
    _dots(axes, savings)
    on_front = sorted((p for p in savings if p.front), key=lambda point: point.cost)
    axes.plot(
        [100 * p.cost for p in on_front], [p.fidelity for p in on_front],
        color=FRONT, linewidth=1.6, drawstyle="steps-post", zorder=3, label="Pareto front",
    )  # fmt: skip
    for number, point in enumerate(p for p in rungs if p.rung in NAMED):
        place = (100 * point.cost, point.fidelity)
        axes.plot(*place, "o", markersize=9, markerfacecolor="none", color=FRONT, zorder=4)
        axes.annotate(
            f"{point.rung}\n{point.candidate.name}", place, xytext=(0, 14 + 26 * number),
            textcoords="offset points", color=FRONT, ha="center", fontsize=9, zorder=5,
            arrowprops={"arrowstyle": "-", "color": FRONT, "linewidth": 0.6},
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(left=ROOM * 100 * min((point.cost for point in savings), default=1.0))
    ticks = [tick for tick in (5, 7, 10, 15, 25, 40, 60, 100) if _within(tick, savings)]
    axes.set_xticks(ticks)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} %"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(f"time, of the exact plan's{_seconds(found)}")
    axes.set_ylabel("PSNR against the exact plan's picture, dB")
    axes.set_title(f"What accuracy costs in time — {what}", loc="left", fontsize=11)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="lower right", fontsize=9)
    for path in files:
        figure.savefig(path, dpi=DOTS, metadata=_dateless(path))


def _dots(axes: Any, savings: Sequence[Point]) -> None:
    groups: dict[tuple[str, bool], list[Point]] = {}
    for point in savings:
        whole = "guidance_interval" not in point.candidate.options
        groups.setdefault((_solver(point), whole), []).append(point)
    for (solver, whole), group in sorted(groups.items()):
        colour = COLOURS.get(solver, OTHER)
        axes.scatter(
            [100 * p.cost for p in group], [p.fidelity for p in group],
            s=22, edgecolors=colour, facecolors=colour if whole else "none", linewidths=1.0,
            zorder=2, label=f"{solver}{'' if whole else ', guided in some steps'}",
        )  # fmt: skip


def _solver(point: Point) -> str:
    """The solver; of another model, the model."""
    name = point.candidate.name
    if ":" in name:
        return name.partition(":")[0]
    return str(point.candidate.options.get("solver", "ddim"))


def _within(tick: float, savings: Sequence[Point]) -> bool:
    costs = [100 * point.cost for point in savings]
    return bool(costs) and 0.8 * min(costs) <= tick <= 1.25 * max(costs)


def _seconds(found: Sequence[Point]) -> str:
    seconds = found[0].seconds
    return "" if seconds is None else f" {seconds:.2f} s"


def _dateless(path: Path) -> dict[str, Any]:
    """The same figures give the same file."""
    return {"Date": None} if path.suffix == ".svg" else {"Software": None}
