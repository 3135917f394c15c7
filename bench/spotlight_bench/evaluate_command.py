"""``spotlight-bench evaluate``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from spotlight_bench import arguments as a

if TYPE_CHECKING:
    from spotlight_bench.evaluate import Work
    from spotlight_bench.methods import Method
    from spotlight_bench.results import ResultStore

__all__ = ["evaluate"]

HELD_OUT: Final = Path("testset")
"""Where `spotlight-train export-testset` is told to write in the documentation."""
USER_SCENES: Final = 30
QUICK_SCENES: Final = 6
QUICK_USER_SCENES: Final = 2
SHOWN_SCENES: Final = 4
"""Scenes on the sheet and in the animation."""
PIPED_WIDTH: Final = 140
"""Columns where the output is no terminal, so that no figure is cut off."""


def evaluate(
    data: Annotated[
        Path, typer.Option(help="Test set: a folder a scene, in the published layout.")
    ] = HELD_OUT,
    model: Annotated[str, typer.Option(help="Model name or folder: `spotlight models`.")] = "mini",
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for tables, sheets and results.")
    ] = Path("evaluation"),
    methods: Annotated[
        str | None,
        typer.Option(help="Built-in methods, separated by commas.", show_default="all"),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=FOLDER: another method's pictures, FOLDER/SCENE/DIRECTION.png. Repeatable."
        ),
    ] = None,
    scenes: Annotated[
        int | None,
        typer.Option(min=0, help="Scenes, reference-based.", show_default="all"),
    ] = None,
    user_scenes: Annotated[
        int | None,
        typer.Option(min=0, help="Scenes, user-controlled: eight azimuths.", show_default="30"),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Denoising steps.", show_default="the backbone's")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of all noise.")] = 469,
    quick: Annotated[
        bool, typer.Option("--quick", help="A few scenes and the main methods: minutes.")
    ] = False,
    resume: a.Resume = False,
    images: Annotated[
        bool, typer.Option("--images", help="Write every picture, not only those on the sheet.")
    ] = False,
    json_file: a.JsonFile = None,
    threads: a.Threads = None,
) -> None:
    """Compare methods on a test set: figures with intervals, light following, sheet, animation.

    Example: spotlight-bench evaluate --data testset --model mini --quick -o quick
    """
    from spotlight_bench import evaluate as bench
    from spotlight_bench.backbone import Backbone
    from spotlight_bench.dataset import fingerprint
    from spotlight_bench.methods import BUILT_IN, QUICK, choose
    from spotlight_bench.perceptual import PerceptualDistance
    from spotlight_bench.results import RESULTS_FILE, ResultStore
    from spotlight_runtime import RelightOptions
    from spotlight_runtime.networks.sessions import available_cpus

    # Nothing between commas is no name: with "" there are the folders' methods alone.
    wanted = tuple(QUICK if quick else BUILT_IN) if methods is None else a.names(methods)
    chosen = choose(wanted, method or ())
    reference = QUICK_SCENES if quick and scenes is None else scenes
    user = (QUICK_USER_SCENES if quick else USER_SCENES) if user_scenes is None else user_scenes
    work = bench.plan(data, reference, user, SHOWN_SCENES, keep_images=images)
    bench.check_folders(chosen, work)
    options = RelightOptions(seed=seed, steps=steps)
    threads = threads or available_cpus()
    backbone = Backbone.load(model, threads)
    settings = {
        "model": backbone.facts["name"],
        "fingerprint": backbone.facts["fingerprint"],
        "precision": backbone.facts["precision"],
        "steps": options.steps_for(backbone.spec),
        "seed": seed,
        "data": data.name,
        "data_fingerprint": fingerprint(data),
        "version": version("spotlight-relight"),
    }
    output.mkdir(parents=True, exist_ok=True)
    store = ResultStore(output / RESULTS_FILE, settings, resume=resume)
    run = bench.evaluate(
        backbone, chosen, work, options, store, output, PerceptualDistance(threads)
    )
    _with_progress(run, sum(len(item.directions) for item in work))
    _report(output, json_file, chosen, work, store, settings)


def _with_progress(run: Any, total: int) -> None:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    with bar:
        task = bar.add_task("directions", total=total)
        for done in run:
            bar.update(task, advance=1, description=f"{done.scene} {done.direction}")


def _report(
    output: Path,
    json_file: Path | None,
    methods: Sequence[Method],
    work: Sequence[Work],
    store: ResultStore,
    settings: dict[str, Any],
) -> None:
    """Write and print everything that is made of the results."""
    from rich.console import Console

    from spotlight_bench import sheet, tables
    from spotlight_bench.claims import check_claims
    from spotlight_bench.dataset import load_scene
    from spotlight_bench.summary import summarise
    from spotlight_spec import replacing, write_json

    planned = {(item.folder.name, name) for item in work for name in item.directions}
    results = [result for result in store if result.key[:2] in planned]
    summary = summarise(results, methods)
    claims = check_claims(summary)
    texts = {
        "tables.md": tables.as_markdown(summary, claims, settings),
        "images.csv": tables.images_csv(results),
        "methods.csv": tables.methods_csv(summary),
    }
    for name, text in texts.items():
        with replacing(output / name) as partial:
            partial.write_text(text, encoding="utf-8")
    if json_file is not None:
        write_json(json_file, tables.as_json(summary, claims, settings))
    shown = [load_scene(item.folder, item.directions) for item in work[:SHOWN_SCENES]]
    rows = sheet.sheet_rows(shown)
    sheet.qualitative_sheet(output / "sheet.png", output, rows, methods, results)
    sheet.animate(output / "directions.webp", output, shown, methods)

    width = None if sys.stdout.isatty() else PIPED_WIDTH
    console = Console(width=width)
    found = list(tables.grids(summary))
    for grid in found:
        console.print(tables.as_rich(grid))
    if not found:
        console.print(f"No truths in this set, so no figures; the pictures are in {output}/images.")
    for claim in claims:
        console.print(f"{'holds' if claim.holds else 'FAILS'}  {claim.text}: {claim.found}")
    written = sorted(path.name for path in output.iterdir() if path.is_file())
    console.print(f"{output}: {', '.join(written)}")
