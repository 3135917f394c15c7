"""``spotlight-bench stability``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer

from spotlight_bench import arguments as a

__all__ = ["stability"]

REPORT: Final = "stability.md"
PLOT: Final = "stability.png"


def stability(
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help=f"Folder: its {REPORT} gets the tables, {PLOT} is drawn anew."
        ),
    ] = Path("stability"),
    model: Annotated[
        list[str] | None,
        typer.Option(help="Model name or folder. Repeatable.", show_default="mini"),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="No runs of 1000 steps, models at γ = 3 alone.")
    ] = False,
    json_file: a.JsonFile = None,
    threads: a.Threads = None,
) -> None:
    """How rounding errors grow over the steps, case by case and precision by precision.

    Example: spotlight-bench stability --quick -o stability
    """
    from rich.console import Console

    from spotlight_bench import stability_report as report
    from spotlight_bench.stability import measure_all
    from spotlight_bench.stability_cases import LOOP_CASES
    from spotlight_bench.stability_models import GAMMAS, measure_model

    output.mkdir(parents=True, exist_ok=True)
    cases = [case for case in LOOP_CASES if not (quick and case.full)]
    with Console(stderr=True).status("starting") as status:
        measured = list(measure_all(cases, report=status.update))
        gammas = GAMMAS[1:2] if quick else GAMMAS
        models = [
            each
            for name in model or ["mini"]
            for each in measure_model(name, gammas, status.update, threads)
        ]
    target = output / REPORT
    report.write_section(target, "loop", report.loop_table(measured))
    report.write_section(target, "models", report.model_table(models))
    report.plot(measured, output / PLOT)
    if json_file is not None:
        figures = {"loop": list(map(asdict, measured)), "models": list(map(asdict, models))}
        json_file.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    refused = sum(bool(each.refused) for each in (*measured, *models))
    print(f"{target}: {len(cases)} cases, {refused} runs refused")
