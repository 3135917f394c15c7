"""``spotlight relight``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.colour import luma
from spotlight_runtime.images import check_target, read_image, write_image
from spotlight_runtime.options import RelightOptions
from spotlight_runtime.relighter import Relighter
from spotlight_runtime.result import RelightResult
from spotlight_runtime.scene import Scene
from spotlight_spec import write_json

__all__ = ["relight"]


def relight(
    scene: Annotated[
        Path, typer.Argument(help="Scene folder or zip: scene.json, or the published layout.")
    ],
    shadow: Annotated[
        Path,
        typer.Option(help="Guiding shadow: grey image of the scene's size, white is shadow."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Picture to write.")],
    negative: Annotated[
        str, typer.Option(help="Shadow of the opposite light (an image), or none.")
    ] = "none",
    model: Annotated[str, typer.Option(help="Model name or folder: `spotlight models`.")] = "mini",
    report: Annotated[
        Path | None, typer.Option(help="Write options, timings and peak memory here as JSON.")
    ] = None,
    gamma: Annotated[float, typer.Option(help="How strongly the shadow steers the shading.")] = 3.0,
    beta: Annotated[float, typer.Option(help="How strongly the shadow enters the picture.")] = 0.05,
    seed: Annotated[int, typer.Option(help="Same seed, same picture.")] = 469,
    steps: Annotated[
        int | None, typer.Option(help="Denoising steps.", show_default="the backbone's")
    ] = None,
    solver: Annotated[Literal["ddim", "dpmpp_2m", "unipc"], typer.Option()] = "ddim",
    fidelity: Annotated[
        Literal["paper", "release"],
        typer.Option(help="Follow the paper, or the public release to the letter."),
    ] = "paper",
    denoise: Annotated[
        bool | None,
        typer.Option("--denoise/--no-denoise", show_default="where the backbone needs it"),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(help="Threads.", show_default="all this process may use")
    ] = None,
    low_memory: Annotated[
        bool, typer.Option("--low-memory", help="Hold one network at a time; slower to repeat.")
    ] = False,
) -> None:
    """Relight a scene's object by a guiding shadow.

    Example: spotlight relight chair/ --shadow left.png --negative right.png -o out.png
    """
    options = RelightOptions(
        gamma=gamma,
        beta=beta,
        seed=seed,
        steps=steps,
        solver=solver,
        fidelity=fidelity,
        denoise=denoise,
    )
    check_target(output)  # now, not after the minutes a relight takes
    loaded = Scene.load(scene)
    positive = _read_shadow(shadow)
    opposite = None if negative == "none" else _read_shadow(Path(negative))
    relighter = Relighter.load(model, threads=threads, low_memory=low_memory)
    result = _run_with_progress(relighter, loaded, positive, opposite, options)
    write_image(output, result.image)
    facts = {"scene": loaded.name, "output": str(output), **result.report()}
    if report is not None:
        write_json(report, facts)
    total = sum(result.timings.values())
    print(f"{output}: {result.evaluations} evaluations, {total:.1f} s", file=sys.stderr)


def _run_with_progress(
    relighter: Relighter,
    scene: Scene,
    shadow: FloatArray,
    negative: FloatArray | None,
    options: RelightOptions,
) -> RelightResult:
    bar = Progress(
        TextColumn("{task.description:>10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    tasks = {}
    run = relighter.run(scene, shadow, negative, options)
    with bar:
        while True:
            try:
                progress = next(run)
            except StopIteration as stop:
                result: RelightResult = stop.value
                return result
            if progress.stage not in tasks:
                tasks[progress.stage] = bar.add_task(progress.stage, total=progress.steps)
            bar.update(tasks[progress.stage], completed=progress.step.index + 1)


def _read_shadow(path: Path) -> FloatArray:
    pixels = read_image(path)
    if pixels.ndim == 3:
        pixels = luma(pixels[..., :3]) if pixels.shape[2] >= 3 else pixels[..., 0]
    return np.clip(pixels, 0.0, 1.0)
