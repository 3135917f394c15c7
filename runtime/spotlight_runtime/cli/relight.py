"""``spotlight relight``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from spotlight_runtime.cli import arguments as a
from spotlight_runtime.cli.lighting import Asked, choose_lighting
from spotlight_runtime.cli.pictures import relit, shadow_of, sketches, write_sheet
from spotlight_runtime.cli.progress import notices
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.imaging.images import check_place, check_target, write_image
from spotlight_runtime.imaging.picture_files import write_picture
from spotlight_runtime.relighting.relighter import Relighter
from spotlight_runtime.relighting.sweep import check_animation
from spotlight_runtime.relighting.tasks import check_wishes
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import write_json

__all__ = ["relight"]


def relight(
    scene: a.SceneFolder,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Picture to write: .png .jpg .webp, or .exr .hdr (linear light)."
        ),
    ],
    azimuth: a.Azimuth = None,
    shadow: a.Shadow = None,
    light: a.LightName = None,
    lights: a.LightsFile = None,
    sweep: a.Sweep = None,
    elevation: a.Elevation = None,
    radius: a.Radius = None,
    distance: a.Distance = None,
    directional: a.Directional = False,
    softness: a.Softness = None,
    invert: a.Invert = False,
    negative: a.Negative = None,
    preview: Annotated[
        bool,
        typer.Option("--preview", help="Sketch shadow and composite in a blink, no diffusion."),
    ] = False,
    shadow_out: Annotated[
        Path | None, typer.Option(help="Write the guiding shadow here, too.")
    ] = None,
    animation: Annotated[
        Path | None, typer.Option(help="With --sweep: write .mp4, .gif or .webp here, too.")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(help="Write plan, options, timings and peak memory here as JSON."),
    ] = None,
    model: a.Model = "mini",
    plan: a.Named = None,
    budget: a.Budget = None,
    gamma: a.Gamma = None,
    beta: a.Beta = None,
    seed: a.Seed = None,
    steps: a.Steps = None,
    solver: a.Solver = None,
    plain_steps: a.PlainSteps = None,
    guidance_interval: a.GuidanceInterval = None,
    reuse: a.Reuse = None,
    fidelity: a.Fidelity = None,
    window: a.Window = None,
    detail: a.Detail = None,
    denoise: a.Denoise = None,
    engine: a.Engine = "onnxruntime",
    threads: a.Threads = None,
    low_memory: Annotated[
        bool,
        typer.Option(
            "--low-memory",
            help="Hold one network at a time; slower to repeat.",
            rich_help_panel=a.MACHINE,
        ),
    ] = False,
) -> None:
    """Relight a scene's object: say where the light is, or draw its shadow.

    Try a light, then relight by it:

        spotlight relight chair/ --azimuth 135 --elevation 45 --preview -o sketch.png

        spotlight relight chair/ --azimuth 135 --elevation 45 -o out.png

    In a given time, or in the least (`spotlight plan` shows what would run):

        spotlight relight chair/ --azimuth 135 --budget 1.5 -o out.png

        spotlight relight chair/ --azimuth 135 --plan draft -o out.png

    By a drawn shadow, and by all lights round the object:

        spotlight relight chair/ --shadow left.png --negative right.png -o out.png

        spotlight relight chair/ --sweep 8 -o sheet.png --animation turn.mp4

    The picture has the photograph's size, and what neither object nor shadow covers is untouched.
    """
    wishes = a.wishes(
        plan=plan,
        budget=budget,
        gamma=gamma,
        beta=beta,
        seed=seed,
        steps=steps,
        solver=solver,
        plain_steps=plain_steps,
        guidance_interval=guidance_interval,
        reuse=reuse,
        fidelity=fidelity,
        denoise=denoise,
        window=window,
        detail=detail,
    )
    check_wishes(wishes)
    for target in (output, shadow_out):  # now, not after the minutes a relight takes
        if target is not None:
            check_target(target)
    if report is not None:
        check_place(report)
    if animation is not None:
        if sweep is None:
            raise InvalidInputError("--animation: expected --sweep beside it, say --sweep 8")
        check_animation(animation)
    if shadow_out is not None and sweep is not None:
        raise InvalidInputError("--shadow-out: expected one picture's, got --sweep; leave one out")
    asked = Asked(
        azimuth=azimuth,
        elevation=elevation,
        radius=radius,
        distance=distance,
        directional=directional,
        shadow=shadow,
        negative=negative,
        light=light,
        lights=lights,
        sweep=sweep,
        softness=softness,
        invert=invert,
    )
    loaded = Scene.load(scene)
    lighting = choose_lighting(scene, loaded, asked)
    each, name, mask = sweep is not None, loaded.name, loaded.object_mask
    captions = lighting.captions
    with notices():
        if preview:
            pictures = sketches(loaded, lighting, each)
        else:
            relighter = Relighter.load(model, engine=engine, threads=threads, low_memory=low_memory)
            guides, against = lighting.guides, lighting.negative
            task = relighter.prepare(loaded, guides, against, mixed=not each, **wishes)
            del loaded, lighting, guides  # gigabytes that have served, of a large photograph
            pictures = relit(relighter, task, each)
        if each:
            facts, summary = write_sheet(pictures, mask, captions, output, animation)
        else:
            (picture,) = pictures
            write_picture(output, picture.image)
            if shadow_out is not None:
                write_image(shadow_out, shadow_of(picture.guides))
            facts, summary = picture.report, picture.summary
    if report is not None:
        write_json(report, {"scene": name, "output": str(output), **facts})
    print(f"{output}: {summary}", file=sys.stderr)
