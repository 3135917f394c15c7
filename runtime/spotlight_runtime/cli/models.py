"""``spotlight models``."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from spotlight_runtime.networks.models import find_models

__all__ = ["models"]


def models(
    as_json: Annotated[bool, typer.Option("--json", help="For machines.")] = False,
) -> None:
    """List the models found here: precision, size, provenance."""
    found = [model.summary() for model in find_models()]
    if as_json:
        print(json.dumps(found, indent=2))
        return
    table = Table("name", "backbone", "precision", "MB", "worst error", "made from")
    for model in found:
        error = model["worst_parity"]
        table.add_row(
            model["name"],
            model["backbone"],
            model["precision"],
            f"{model['bytes'] / 1e6:.0f}",
            "not verified" if error is None else f"{error:.1e}",
            model["source"],
        )
    Console().print(table)
    if not found:
        Console(stderr=True).print(
            "No model here. Export one with `spotlight-export`, put its folder under models/, or "
            "name the parent folder in SPOTLIGHT_MODELS."
        )
