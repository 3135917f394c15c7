"""The stability report: tables as Markdown, one plot, and the sections they are put into."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from spotlight_bench.stability import REDUCED, UNIT_ROUNDOFF, Measured
from spotlight_bench.stability_models import ModelMeasured
from spotlight_bench.stability_network import Precision

__all__ = ["loop_table", "model_table", "plot", "write_section"]

DRAWN: Final = ("ddim, 50 steps", "γ = 15", "latents of 1e4", "ddim, 1000 steps")
"""Cases whose errors are drawn step by step."""
COLOURS: Final = {"fp32": "#2563a8", "fp16": "#c77d0a", "int8": "#a4243b"}
STYLES: Final = ("-", "--", ":", "-.")
NOTHING: Final = "–"


def loop_table(measured: Sequence[Measured]) -> str:
    """One row a case: float32 in full, the other precisions by their last step."""
    head = (
        "| case | fp32: one step | last step | growth | sensitivity "
        "| fp16: last step | sensitivity | int8: last step | sensitivity |"
    )
    lines = [head, "|---|" + "---:|" * 8]
    for case, of in _by_case(measured).items():
        full = of["fp32"]
        cells = [NOTHING] * 4
        if full.finite:
            cells = [_error(full.one_step), _error(full.errors[-1]), f"{full.growth:.1f}"]
            cells.append(_number(full.sensitivities[-1]))
        for precision in REDUCED[1:]:
            one = of[precision]
            cells.append(_error(one.errors[-1]) if one.finite else "refused")
            cells.append(_number(one.sensitivities[-1]) if one.finite else NOTHING)
        lines.append(f"| {case} | " + " | ".join(cells) + " |")
    finite = sum(each.finite for each in measured)
    lines += ["", f"Finite: {finite} of {len(measured)} runs."]
    return "\n".join(lines)


def model_table(measured: Sequence[ModelMeasured]) -> str:
    """One row a model and γ."""
    lines = [
        "| model | precision | γ | finite | sensitivity: largest | last step "
        "| rounded once more: first step | last step |",
        "|---|---|---:|---|---:|---:|---:|---:|",
    ]
    for each in measured:
        cells = [each.model, each.precision, f"{each.gamma:g}"]
        if each.refused:
            cells += ["refused", *[NOTHING] * 4]
        else:
            cells += ["yes", _number(max(each.sensitivities)), _number(each.sensitivities[-1])]
            cells += [_error(each.rounded[0]), _error(each.rounded[-1])]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def plot(measured: Sequence[Measured], path: Path) -> None:
    """Errors by step, and the last step's of every case."""
    from matplotlib.figure import Figure

    cases = _by_case(measured)
    figure = Figure(figsize=(13.0, 0.18 * len(cases) + 2.0), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
    longest = 1
    for case, style in zip((name for name in DRAWN if name in cases), STYLES):
        for precision, one in cases[case].items():
            if one.finite:
                steps = range(1, len(one.errors) + 1)
                longest = max(longest, len(one.errors))
                label = f"{case}, {precision}"
                left.loglog(steps, one.errors, style, color=COLOURS[precision], label=label, lw=1.4)
    steps_shown = [1, longest]
    bound = [2.0 * UNIT_ROUNDOFF * step**0.5 for step in steps_shown]
    left.loglog(steps_shown, bound, color="0.6", lw=3.0, alpha=0.5, label="2u√k")
    left.set(xlabel="step", ylabel="relative error of the latents")
    left.set_title("Errors against float64, step by step", loc="left", fontsize=10)
    left.legend(fontsize=7, frameon=False, ncols=2, loc="upper left", bbox_to_anchor=(0.0, 1.0))
    left.set_ylim(top=100.0)
    for precision, colour in COLOURS.items():
        found = [(i, of[precision]) for i, of in enumerate(cases.values()) if of[precision].finite]
        errors = [one.errors[-1] for _, one in found]
        right.semilogx(errors, [i for i, _ in found], "o", color=colour, ms=4.5, label=precision)
    right.set_yticks(range(len(cases)), list(cases), fontsize=7)
    right.set_ylim(len(cases) - 0.5, -0.5)
    right.set_title("Error after the last step, every case", loc="left", fontsize=10)
    right.set_xlabel("relative error of the latents")
    right.legend(fontsize=8, frameon=False, loc="lower right")
    for axes in (left, right):
        axes.grid(visible=True, color="0.9", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)


def write_section(path: Path, name: str, text: str) -> None:
    """Put text between ``<!-- name -->`` and ``<!-- /name -->`` of a file; add them if missing.

    Parameters
    ----------
    path : Path
        Markdown; made if it is not there.
    name : str
        Of the section.
    text : str
    """
    start, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before = path.read_text(encoding="utf-8") if path.is_file() else "# Stability\n"
    section = f"{start}\n{text}\n{end}"
    pattern = re.compile(re.escape(start) + ".*?" + re.escape(end), re.DOTALL)
    after, found = pattern.subn(lambda _: section, before)
    path.write_text(after if found else f"{before.rstrip()}\n\n{section}\n", encoding="utf-8")


def _by_case(measured: Sequence[Measured]) -> Mapping[str, dict[Precision, Measured]]:
    cases: dict[str, dict[Precision, Measured]] = {}
    for each in measured:
        cases.setdefault(each.case, {})[each.precision] = each
    return cases


def _error(value: float) -> str:
    return f"{value:.1e}" if value > 0.0 else "0"


def _number(value: float) -> str:
    return f"{value:.2g}" if value < 1e3 else f"{value:.1e}"
