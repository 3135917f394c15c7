"""The ``spotlight`` command: one module a subcommand, registered here."""

from __future__ import annotations

import sys
from typing import Final

import cv2
import typer

from spotlight_runtime.cli.compose import compose
from spotlight_runtime.cli.demo import demo
from spotlight_runtime.cli.models import models
from spotlight_runtime.cli.plan import plan
from spotlight_runtime.cli.relight import relight
from spotlight_runtime.cli.shadow import shadow
from spotlight_runtime.errors import SpotLightError

__all__ = ["main"]

OUT_OF_MEMORY: Final = -4
"""OpenCV's code, which it gives instead of Python's error."""
MEMORY_ADVICE: Final = "take a smaller picture, --window auto, or --low-memory"

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Relight an object in a photograph by its shadow, on any CPU.",
    epilog="Start with:  spotlight demo,  then  spotlight relight --help",
)


@app.callback()
def _about() -> None:
    """Relight an object in a photograph by its shadow, on any CPU."""


for _command in (demo, compose, shadow, plan, relight, models):
    app.command()(_command)


def main() -> None:
    """Entry point: errors of package and files are one line on stderr and exit code 1."""
    try:
        app()
    except (SpotLightError, OSError) as error:
        print("spotlight:", " ".join(str(error).split()), file=sys.stderr)
        sys.exit(1)
    except MemoryError as error:
        print(f"spotlight: not enough memory ({error}): {MEMORY_ADVICE}", file=sys.stderr)
        sys.exit(1)
    except cv2.error as error:
        if error.code != OUT_OF_MEMORY:
            raise
        print(f"spotlight: not enough memory ({error.err}): {MEMORY_ADVICE}", file=sys.stderr)
        sys.exit(1)
