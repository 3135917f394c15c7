"""``spotlight-bench combinations``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spotlight_bench.combinations import COMBINATIONS, combine

__all__ = ["combinations"]


def combinations(
    inputs: Annotated[Path, typer.Argument(help="Folder of real inputs: hdr/, models/, photos/.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for scenes, pictures and sheet.png.")
    ] = Path("combinations"),
    plan: Annotated[str, typer.Option(help="Plan to relight by.")] = "exact",
    only: Annotated[
        list[str] | None,
        typer.Option(help=f"Some of {', '.join(c.name for c in COMBINATIONS)}."),
    ] = None,
) -> None:
    """Compose and relight real photographs and products, and lay the results out on one sheet.

    Prints every command, so that each can be typed by itself.
    """
    for command, picture in combine(inputs, output, ["--plan", plan], only or []):
        print(f"{command}\n  → {picture}", flush=True)
    print(output / "sheet.png")
