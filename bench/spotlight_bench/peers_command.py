"""``spotlight-bench peers``."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import typer

from spotlight_bench import arguments as a

if TYPE_CHECKING:
    from spotlight_bench.peers import Measured, Row

__all__ = ["peers"]

HEADING: Final = (
    "peer", "plan", "evaluations", "s/evaluation", "× ours", "s/relight", "× our balanced",
    "peak GB", "error, evaluation", "error, picture",
)  # fmt: skip
ROUNDS, RELIGHTS, EVALUATIONS = 3, {"mini": 3, "full": 1, "tiny": 1}, 5
QUICK_ROUNDS, QUICK_EVALUATIONS = 1, 3
PIPED_WIDTH: Final = 150
MINI_NOTE: Final = (
    "The mini has no diffusers model, so torch is left out; errors are held against ONNX Runtime "
    "with its optimisations off."
)


def peers(
    size: Annotated[
        Literal["mini", "full", "tiny"],
        typer.Option(
            help="The embedded model; Stable Diffusion 2.1's size with random weights (16 GB of "
            "memory, 20 GB of disk); or a tiny one, to try this out."
        ),
    ] = "mini",
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for tables and what the peers run.")
    ] = Path("peers"),
    ours: Annotated[
        str, typer.Option(help="Precisions of ours, separated by commas; mini has its own.")
    ] = "int8,fp32",
    only: Annotated[
        str,
        typer.Option(help="Peers, by name, separated by commas.", show_default="all"),
    ] = "",
    rounds: Annotated[
        int | None, typer.Option(min=1, help="Turns of every peer.", show_default=str(ROUNDS))
    ] = None,
    relights: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Turns with whole relights; 0: evaluations alone.",
            show_default="3, 1 at full size",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One turn, few evaluations.")] = False,
    json_file: a.JsonFile = None,
    threads: a.Threads = None,
) -> None:
    """Hold the runtime against diffusers, OpenVINO and a plain export: time, memory, error.

    Example: spotlight-bench peers --size mini --quick -o peers
    """
    from rich.console import Console

    from spotlight_bench import peers as bench
    from spotlight_bench.peers_prepare import SIZES, mini_peers, torch_peers
    from spotlight_runtime.networks.sessions import available_cpus
    from spotlight_spec import replacing, write_json

    errors = Console(stderr=True)
    openvino = find_spec("openvino") is not None
    if not openvino:
        errors.print(
            "OpenVINO is left out: pip install 'spotlight-relight[openvino]'", markup=False
        )
    threads = threads or available_cpus()
    output.mkdir(parents=True, exist_ok=True)
    with errors.status("preparing") as status:
        if SIZES[size].checkpoint:
            precisions = a.names(ours)
            chosen, spec = torch_peers(SIZES[size], output, precisions, openvino, status.update)
        else:
            chosen, spec = mini_peers(openvino)
        chosen = bench.among(chosen, a.names(only))
        measured = []
        for one in bench.measure(
            chosen, spec, output / "runs", side=SIZES[size].side, threads=threads,
            rounds=rounds or (QUICK_ROUNDS if quick else ROUNDS),
            relights=relights if relights is not None else 1 if quick else RELIGHTS[size],
            evaluations=QUICK_EVALUATIONS if quick else EVALUATIONS,
        ):  # fmt: skip
            measured.append(one)
            status.update(f"round {one.round + 1}: {one.peer} done")
    found = bench.rows(chosen, measured, output / "runs")
    settings = {"size": size, "side": SIZES[size].side, "threads": threads}
    note = "" if SIZES[size].checkpoint else MINI_NOTE
    texts = {"peers.csv": _csv(found), "peers.md": _markdown(found, settings, note)}
    for name, text in texts.items():
        with replacing(output / name) as partial:
            partial.write_text(text, encoding="utf-8")
    if json_file is not None:
        write_json(json_file, _record(found, measured, settings))
    _show(found, note)


def _cells(row: Row) -> list[str]:
    def known(value: float | None, how: str) -> str:
        return "–" if value is None else format(value, how)

    memory = None if row.peak_memory_bytes is None else row.peak_memory_bytes / 1e9
    return [
        row.peer.label, row.plan or "–", known(row.evaluations, "d"),
        f"{row.evaluation_seconds:.3g}", f"{row.times_ours:.2f}",
        known(row.relight_seconds, ".3g"), known(row.relight_times_ours, ".2f"),
        known(memory, ".2f"), f"{row.evaluation_error:.1e}", known(row.relight_error, ".1e"),
    ]  # fmt: skip


def _markdown(found: Sequence[Row], settings: dict[str, Any], note: str) -> str:
    lines = ["# Peers", "", *(f"* {key}: {value}" for key, value in settings.items()), ""]
    lines += [note, ""] if note else []
    lines += ["| " + " | ".join(HEADING) + " |", "|---" * len(HEADING) + "|"]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in found]
    return "\n".join(lines) + "\n"


def _csv(found: Sequence[Row]) -> str:
    file = io.StringIO()
    records = [_flat(row) for row in found]
    writer = csv.DictWriter(file, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return file.getvalue()


def _record(
    found: Sequence[Row], measured: Sequence[Measured], settings: dict[str, Any]
) -> dict[str, Any]:
    return {
        "settings": settings,
        "rows": [_flat(row) for row in found],
        "measured": [asdict(one) for one in measured],
    }


def _flat(row: Row) -> dict[str, Any]:
    """A row without where its files lie."""
    named = {"peer": row.peer.name, "engine": row.peer.engine, "precision": row.peer.precision}
    return named | {key: value for key, value in asdict(row).items() if key != "peer"}


def _show(found: Sequence[Row], note: str) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Peers", title_justify="left", title_style="bold")
    for number, name in enumerate(HEADING):
        table.add_column(name, justify="left" if number < 2 else "right")
    for row in found:
        table.add_row(*_cells(row))
    console = Console(width=None if sys.stdout.isatty() else PIPED_WIDTH)
    console.print(table)
    if note:
        console.print(note, markup=False)
