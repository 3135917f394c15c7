"""``spotlight demo``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from spotlight_runtime.cli.lighting import Asked, choose_lighting
from spotlight_runtime.cli.pictures import relit, write_sheet
from spotlight_runtime.cli.progress import notices
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.imaging.images import check_target
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.relighting.relighter import Relighter
from spotlight_runtime.scenes.scene import Scene

__all__ = ["demo"]


SCENES: Final = Path(__file__).parent.parent / "demo"
"""Small scenes that come with the package, made by the project's own renderer."""


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Contact sheet to write.")] = Path(
        "demo.png"
    ),
    scene: Annotated[
        str | None,
        typer.Option(
            help="Which of the scenes that come along: bench, berries, goblet.",
            show_default="the first",
        ),
    ] = None,
    lights: Annotated[int, typer.Option(help="How many lights all round the object.")] = 8,
    steps: Annotated[
        int | None, typer.Option(help="Denoising steps.", show_default="the backbone's")
    ] = None,
    model: Annotated[str, typer.Option(help="Model name or folder.")] = "mini",
) -> None:
    """Relight a scene that comes along from all round, on a contact sheet.

    Each picture shows its guiding shadow in the corner. Nothing has to be downloaded or given.
    """
    check_target(output)
    folder = find_scene(scene)
    loaded = Scene.load(folder)
    lighting = choose_lighting(folder, loaded, Asked(sweep=lights))
    relighter = Relighter.load(model)
    with notices():
        task = relighter.prepare(
            loaded, lighting.guides, lighting.negative, RelightOptions(steps=steps)
        )
        pictures = relit(relighter, task, each=True)
        _, summary = write_sheet(pictures, loaded.object_mask, lighting.captions, output, None)
    print(f"{output}: {summary}", file=sys.stderr)


def find_scene(name: str | None) -> Path:
    """Folder of a bundled scene; the first of them by default."""
    folders = {path.name: path for path in sorted(SCENES.iterdir())}
    if name is None:
        return next(iter(folders.values()))
    if name not in folders:
        raise InvalidInputError(f"scene: expected one of {', '.join(folders)}, got {name!r}")
    return folders[name]
