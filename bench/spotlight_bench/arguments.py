"""Arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["JsonFile", "Resume", "Threads", "names"]

JsonFile = Annotated[
    Path | None, typer.Option("--json", help="Write all figures here, for machines.")
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with the results in the output folder.")
]
Threads = Annotated[
    int | None, typer.Option(min=1, help="Threads.", show_default="all this process may use")
]


def names(given: str) -> tuple[str, ...]:
    """Names that were given separated by commas."""
    return tuple(name.strip() for name in given.split(",") if name.strip())
