"""The command line of training: render, pack, train, export.

Heavy imports live inside the commands, so that `--help` answers at once and each command needs only
its own packages.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from .loop import TrainingOptions

app = typer.Typer(
    name="spotlight-train",
    no_args_is_help=True,
    add_completion=False,
    help="Render training data and train SpotLight.",
)


@app.command()
def render(
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Folder for the records; a folder per split below it."),
    ],
    split: Annotated[
        str, typer.Option(help="train, val or test: disjoint scenes, object kinds and panoramas.")
    ] = "train",
    count: Annotated[int, typer.Option(min=1, help="Scenes to render.")] = 100,
    first_seed: Annotated[int, typer.Option(min=0, help="Seed of the first scene.")] = 0,
    stride: Annotated[
        int, typer.Option(min=1, help="Step between seeds, to share a range among processes.")
    ] = 1,
    lights: Annotated[int, typer.Option(min=1, max=16, help="Dominant lights a scene.")] = 6,
    evaluation: Annotated[
        bool,
        typer.Option(
            "--evaluation", help="Eight azimuths at 45 degrees plus a random direction instead."
        ),
    ] = False,
    spp: Annotated[int, typer.Option(help="Samples a pixel, a square number.")] = 16,
    size: Annotated[int, typer.Option(min=16, max=2048, help="Image side in pixels.")] = 256,
    quality: Annotated[
        str, typer.Option(help="Denoiser network: fast, balanced or high.")
    ] = "fast",
    variant: Annotated[str, typer.Option(help="Renderer back end: auto, cuda or llvm.")] = "auto",
    objects: Annotated[
        Path | None,
        typer.Option(
            help="Folder of glTF or OBJ objects to insert as well. Each goes to one split by a "
            "hash of its name: eight in ten to train, one in ten each to val and test."
        ),
    ] = None,
    hdris: Annotated[Path | None, typer.Option(help="Folder of the panoramas.")] = None,
    no_hdris: Annotated[bool, typer.Option("--no-hdris", help="Use gradient skies only.")] = False,
    threads: Annotated[
        int | None, typer.Option(min=1, help="CPU threads; all if not given.")
    ] = None,
) -> None:
    """Render scenes into records; run it again to go on where it stopped."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from .render.external import find_objects
    from .render.scenes import SceneOptions
    from .render.variant import select_variant

    backend = select_variant(variant, threads)

    from .render.denoise import Denoiser
    from .render.driver import render_range
    from .render.pipeline import RenderOptions

    extents = find_objects(objects) if objects else {}
    scene_options = SceneOptions(lights, evaluation, use_hdris=not no_hdris, file_extents=extents)
    options = RenderOptions(side=size, spp=spp, objects=objects, hdris=hdris)
    seeds = range(first_seed, first_seed + count * stride, stride)
    typer.echo(f"rendering {count} {split} scenes with {backend} into {output / split}")
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, disable=not sys.stdout.isatty()) as bar:
        task = bar.add_task(split, total=count)
        denoiser = Denoiser(threads, quality)
        for progress in render_range(split, seeds, output, scene_options, options, denoiser):
            bar.update(task, advance=1, description=f"{split} {progress.seconds:.1f} s a scene")
            if not sys.stdout.isatty() and not progress.skipped:
                typer.echo(
                    f"{progress.path.name} {progress.seconds:.1f} s "
                    f"({progress.done}/{progress.total})"
                )
        denoiser.close()


@app.command()
def hdris(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for the panoramas.")
    ] = None,
) -> None:
    """Fetch Poly Haven's eight CC0 panoramas, as Blender's Python package bundles them."""
    from .render.panoramas import fetch

    for path in fetch(output):
        typer.echo(str(path))


@app.command("export-testset")
def export_testset(
    records: Annotated[Path, typer.Argument(help="Folder of records rendered with --evaluation.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the scenes, one folder each.")
    ],
    light: Annotated[
        str, typer.Option(help="The light of the truth, background and composite.")
    ] = "gt_dir",
) -> None:
    """Write records in the layout of the published SpotLight test set."""
    from .render.testset import export_folder

    for path in export_folder(records, output, light):
        typer.echo(str(path))


@app.command("export-scene")
def export_scene(
    record: Annotated[Path, typer.Argument(help="A rendered record, NNNNNN.scene.zip.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Scene folder to write.")],
    light: Annotated[str, typer.Option(help="The light of the photograph.")] = "gt_dir",
    objects: Annotated[
        Path | None, typer.Option(help="Folder of objects, where `render --objects` had one.")
    ] = None,
) -> None:
    """Write a record as a scene for `spotlight relight`, with the object's mesh."""
    from .render.bundle import export_bundle

    typer.echo(str(export_bundle(record, output, light, objects)))


@app.command()
def pack(
    records: Annotated[Path, typer.Argument(help="Folder of rendered scenes of one split.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Packed file to write.")],
) -> None:
    """Pack rendered scenes into one memory-mapped file to train from."""
    from .data import pack as pack_records

    typer.echo(f"{output}: {pack_records(records, output)} scenes")


Data = Annotated[Path, typer.Option("--data", help="Packed training scenes.")]
HeldOut = Annotated[Path, typer.Option("--held-out", help="Packed validation scenes.")]
Run = Annotated[Path, typer.Option("--run", help="Folder of the run; an old run goes on.")]
Steps = Annotated[int, typer.Option(min=0, help="Optimiser steps in all.")]
Minutes = Annotated[float | None, typer.Option(help="Stop after so long, to go on later.")]
BatchSize = Annotated[int, typer.Option("--batch", help="Samples a step.")]
LearningRate = Annotated[float, typer.Option(help="Peak learning rate.")]
Device = Annotated[str, typer.Option(help="cpu or cuda.")]
Threads = Annotated[int, typer.Option(help="Threads that prepare batches.")]
Seed = Annotated[int, typer.Option(help="Of weights, samples and noise.")]
Width = Annotated[int, typer.Option(help="Channels of the first level.")]
Side = Annotated[int, typer.Option(min=32, max=256, help="Side of the training pictures.")]
Start = Annotated[
    Path | None, typer.Option("--start", help="Run whose weights a new run starts from.")
]


@app.command()
def vae(
    data: Data,
    held_out: HeldOut,
    run: Run,
    steps: Steps = 40_000,
    minutes: Minutes = None,
    batch: BatchSize = 8,
    learning_rate: LearningRate = 5e-4,
    device: Device = "cpu",
    threads: Threads = 1,
    seed: Seed = 0,
    latent: Annotated[int, typer.Option(help="Latent channels.")] = 16,
    width: Width = 64,
    side: Side = 128,
    start: Start = None,
) -> None:
    """Train the autoencoder; the run folder has loss curve and sample sheet as it goes."""
    from . import runs

    options = _options(steps, minutes, batch, learning_rate, device, threads, seed)
    runs.train_vae(data, held_out, run, options, latent=latent, width=width, side=side, start=start)


@app.command()
def renderer(
    data: Data,
    held_out: HeldOut,
    vae_run: Annotated[Path, typer.Option("--vae", help="Run folder of the trained VAE.")],
    run: Run,
    steps: Steps = 60_000,
    minutes: Minutes = None,
    batch: BatchSize = 16,
    learning_rate: LearningRate = 3e-4,
    device: Device = "cpu",
    threads: Threads = 1,
    seed: Seed = 0,
    width: Width = 64,
    side: Side = 256,
    start: Start = None,
    depth: Annotated[int, typer.Option(help="Blocks of the transformer.")] = 12,
    coarse_every: Annotated[
        int,
        typer.Option(help="One step in so many sees four times as many pictures of half the side."),
    ] = 0,
) -> None:
    """Train the latent renderer over a trained autoencoder."""
    from . import runs

    options = replace(
        _options(steps, minutes, batch, learning_rate, device, threads, seed),
        coarse_every=coarse_every,
    )
    runs.train_renderer(
        data, held_out, vae_run, run, options, width=width, side=side, start=start, depth=depth
    )


@app.command()
def intrinsics(
    data: Data,
    held_out: HeldOut,
    run: Run,
    steps: Steps = 30_000,
    minutes: Minutes = None,
    batch: BatchSize = 8,
    learning_rate: LearningRate = 4e-4,
    device: Device = "cpu",
    threads: Threads = 1,
    seed: Seed = 0,
    side: Side = 128,
    start: Start = None,
) -> None:
    """Train the estimator of albedo, normals and depth of a photograph."""
    from . import runs

    options = _options(steps, minutes, batch, learning_rate, device, threads, seed)
    runs.train_intrinsics(data, held_out, run, options, side=side, start=start)


@app.command("export")
def export_model(
    renderer_run: Annotated[Path, typer.Option("--renderer", help="Run folder of the renderer.")],
    vae_run: Annotated[Path, typer.Option("--vae", help="Run folder of the VAE's decoder.")],
    intrinsics_run: Annotated[Path, typer.Option("--intrinsics", help="Run of the estimator.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Model folder to create.")],
    notes: Annotated[
        Path | None,
        typer.Option(help="JSON object of strings for the manifest: how made, how good."),
    ] = None,
    precision: Annotated[str, typer.Option(help="fp32, fp16 or int8 weights.")] = "fp16",
    start_brightness: Annotated[
        float,
        typer.Option(
            min=-1.0,
            max=1.0,
            help="What the initial latents add to a picture in 0 to 1 where sampling starts: set "
            "it to what relit objects are too dark by, less than 0 where they are too bright.",
        ),
    ] = 0.0,
    start_deviation: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Of the initial latents. Less than 1 where pictures should depend less on the "
            "seed than a small renderer lets them.",
        ),
    ] = 1.0,
    force: Annotated[bool, typer.Option("--force", help="Replace a model there.")] = False,
) -> None:
    """Export finished trainings as a model folder, compared with torch graph by graph."""
    import json

    from . import runs
    from .ship import ship

    model, spec = runs.load_renderer(renderer_run)
    runs.take_decoder(model, vae_run)
    manifest = ship(
        model,
        runs.load_estimator(intrinsics_run),
        runs.starting(model, spec, start_brightness, start_deviation),
        output,
        {} if notes is None else json.loads(notes.read_text(encoding="utf-8")),
        precision=precision,  # type: ignore[arg-type]
        force=force,
        report=typer.echo,
    )
    size = sum(entry.bytes for entry in manifest.files) / 1e6
    worst = max(row.max_rel for row in manifest.parity)
    typer.echo(f"{output}: {size:.1f} MB, worst relative error against torch {worst:.1e}")


@app.command()
def restore(
    model: Annotated[str, typer.Argument(help="Model that `export` wrote: its folder or name.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the run folders.")],
) -> None:
    """Take a model's weights out again, as run folders that trainings `--start` from."""
    from .restore import restore as restored

    for run in restored(model, output):
        typer.echo(run)


def _options(
    steps: int,
    minutes: float | None,
    batch: int,
    learning_rate: float,
    device: str,
    threads: int,
    seed: int,
) -> TrainingOptions:
    import torch

    from .loop import TrainingOptions

    torch.manual_seed(seed)
    return TrainingOptions(
        steps=steps,
        minutes=minutes,
        batch=batch,
        learning_rate=learning_rate,
        seed=seed,
        device=device,
        threads=threads,
    )


def main() -> None:
    """Run the command line.

    An error that names its remedy is printed as one line, without a traceback.
    """
    try:
        app()
    except (ValueError, KeyError, OSError, RuntimeError, ImportError) as error:
        # A KeyError's text is its argument's repr, an OSError's first argument a mere number.
        message = str(error.args[0]) if isinstance(error, KeyError) else str(error)
        if isinstance(error, ImportError):
            message += ". Install what it needs: pip install 'spotlight-relight[training]'"
        typer.echo(f"spotlight-train: {message}", err=True)
        raise SystemExit(1) from error


if __name__ == "__main__":
    main()
