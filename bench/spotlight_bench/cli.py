"""The ``spotlight-bench`` command: one module a subcommand, registered here."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from typing import Final

import typer

from spotlight_bench.errors import BenchError
from spotlight_runtime.errors import SpotLightError

__all__ = ["main"]

EXTRAS: Final = ("skimage", "flip_evaluator", "stlpips_pytorch", "torch", "PIL")

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Measure backbones and methods against ground truth.",
)


@app.callback()
def _about() -> None:
    """Measure backbones and methods against ground truth."""


def main() -> None:
    """Entry point: errors of packages and files are one line on stderr and exit code 1."""
    if missing := [name for name in EXTRAS if find_spec(name) is None]:
        sys.exit(
            f"spotlight-bench: {', '.join(missing)} missing; pip install 'spotlight-relight[bench]'"
        )
    from spotlight_bench.budgets import budgets
    from spotlight_bench.combinations_command import combinations
    from spotlight_bench.evaluate_command import evaluate
    from spotlight_bench.further_lights import further_lights
    from spotlight_bench.pareto_command import pareto
    from spotlight_bench.peers_command import peers
    from spotlight_bench.stability_command import stability

    for command in (evaluate, combinations, pareto, budgets, further_lights, peers, stability):
        app.command()(command)
    try:
        app()
    except (BenchError, SpotLightError, OSError) as error:
        print("spotlight-bench:", " ".join(str(error).split()), file=sys.stderr)
        sys.exit(1)
