"""``spotlight relight``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from spotlight_runtime.cli.lighting import Asked, choose_lighting
from spotlight_runtime.cli.pictures import relit, shadow_of, sketches, write_sheet
from spotlight_runtime.cli.progress import notices
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.imaging.images import check_target, write_image
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.relighting.relighter import Relighter
from spotlight_runtime.relighting.sweep import check_animation
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import write_json

__all__ = ["relight"]


LIGHT = "Light (give one)"
FURTHER = "Light, further"
METHOD = "Method"
MACHINE = "Machine"


def relight(
    scene: Annotated[
        Path, typer.Argument(help="Scene folder or zip: scene.json, or the published layout.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Picture to write (.png .jpg .webp .exr .hdr).")
    ],
    azimuth: Annotated[
        float | None,
        typer.Option(
            help="Where the light is, in degrees round the object: 0 right, 90 behind it, 180 "
            "left, 270 towards the camera.",
            rich_help_panel=LIGHT,
        ),
    ] = None,
    shadow: Annotated[
        Path | None,
        typer.Option(
            help="The light's shadow as a grey image, white is shadow. One of another size than "
            "the scene's is taken for a scribble and cleaned.",
            rich_help_panel=LIGHT,
        ),
    ] = None,
    light: Annotated[
        str | None,
        typer.Option(
            help="A light whose shadow lies ready in the scene, by name: gt_dir, 0003.",
            rich_help_panel=LIGHT,
        ),
    ] = None,
    lights: Annotated[
        Path | None,
        typer.Option(
            help='Several lights as JSON: [{"azimuth": 30, "elevation": 50, "weight": 2, '
            '"colour": [1, 0.8, 0.6]}, …].',
            rich_help_panel=LIGHT,
        ),
    ] = None,
    sweep: Annotated[
        int | None,
        typer.Option(
            help="So many lights all round, each a picture of its own on a contact sheet.",
            rich_help_panel=LIGHT,
        ),
    ] = None,
    elevation: Annotated[
        float | None,
        typer.Option(help="Degrees above the floor.", show_default="45", rich_help_panel=FURTHER),
    ] = None,
    radius: Annotated[
        float,
        typer.Option(
            help="Size of the light, in sizes of the object: the larger, the softer the shadow.",
            rich_help_panel=FURTHER,
        ),
    ] = 1.0,
    distance: Annotated[
        float,
        typer.Option(help="Of the light, in sizes of the object.", rich_help_panel=FURTHER),
    ] = 10.0,
    directional: Annotated[
        bool,
        typer.Option(
            "--directional",
            help="A light infinitely far away, like the sun; --radius is then in degrees (0.27).",
            rich_help_panel=FURTHER,
        ),
    ] = False,
    softness: Annotated[
        float | None,
        typer.Option(
            help="Of a drawn --shadow: pixels over which its edges fade.", rich_help_panel=FURTHER
        ),
    ] = None,
    invert: Annotated[
        bool,
        typer.Option(
            "--invert",
            help="The drawn --shadow is black on white paper.",
            rich_help_panel=FURTHER,
        ),
    ] = False,
    negative: Annotated[
        str | None,
        typer.Option(
            help="What the guidance contrasts with: opposite (light), none, or an image.",
            show_default="opposite; none for --shadow",
            rich_help_panel=FURTHER,
        ),
    ] = None,
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
        Path | None, typer.Option(help="Write options, timings and peak memory here as JSON.")
    ] = None,
    model: Annotated[
        str,
        typer.Option(help="Model name or folder: `spotlight models`.", rich_help_panel=METHOD),
    ] = "mini",
    gamma: Annotated[
        float,
        typer.Option(
            help="How strongly the shadow steers the shading; 1 is not at all.",
            rich_help_panel=METHOD,
        ),
    ] = 3.0,
    beta: Annotated[
        float,
        typer.Option(help="How strongly the shadow enters the picture.", rich_help_panel=METHOD),
    ] = 0.05,
    seed: Annotated[
        int, typer.Option(help="Same seed, same picture.", rich_help_panel=METHOD)
    ] = 469,
    steps: Annotated[
        int | None,
        typer.Option(
            help="Denoising steps.", show_default="the backbone's", rich_help_panel=METHOD
        ),
    ] = None,
    solver: Annotated[
        Literal["ddim", "dpmpp_2m", "unipc"], typer.Option(rich_help_panel=METHOD)
    ] = "ddim",
    fidelity: Annotated[
        Literal["paper", "release"],
        typer.Option(
            help="Follow the paper, or the public release to the letter.",
            rich_help_panel=METHOD,
        ),
    ] = "paper",
    window: Annotated[
        Literal["auto", "frame"],
        typer.Option(
            help="Diffuse a window around object and shadow at the model's scale, or the whole "
            "frame at its own.",
            rich_help_panel=METHOD,
        ),
    ] = "auto",
    detail: Annotated[
        Literal["auto", "renderer", "maps"],
        typer.Option(
            help="Whose detail the object shows: the renderer's pixels, or its shading on the "
            "object's own maps.",
            show_default="maps in a window, the renderer's in a frame",
            rich_help_panel=METHOD,
        ),
    ] = "auto",
    denoise: Annotated[
        bool | None,
        typer.Option(
            "--denoise/--no-denoise",
            show_default="where the backbone needs it",
            rich_help_panel=METHOD,
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            help="Threads.", show_default="all this process may use", rich_help_panel=MACHINE
        ),
    ] = None,
    low_memory: Annotated[
        bool,
        typer.Option(
            "--low-memory",
            help="Hold one network at a time; slower to repeat.",
            rich_help_panel=MACHINE,
        ),
    ] = False,
) -> None:
    """Relight a scene's object: say where the light is, or draw its shadow.

    Try a light, then relight by it:

        spotlight relight chair/ --azimuth 135 --elevation 45 --preview -o sketch.png

        spotlight relight chair/ --azimuth 135 --elevation 45 -o out.png

    By a drawn shadow, and by all lights round the object:

        spotlight relight chair/ --shadow left.png --negative right.png -o out.png

        spotlight relight chair/ --sweep 8 -o sheet.png --animation turn.mp4

    The picture has the photograph's size, and what neither object nor shadow covers is untouched.
    """
    options = RelightOptions(
        gamma=gamma,
        beta=beta,
        seed=seed,
        steps=steps,
        solver=solver,
        fidelity=fidelity,
        denoise=denoise,
        window=window,
        detail=detail,
    )
    for target in (output, shadow_out):  # now, not after the minutes a relight takes
        if target is not None:
            check_target(target)
    if animation is not None:
        if sweep is None:
            raise InvalidInputError("--animation: expected --sweep beside it, say --sweep 8")
        check_animation(animation)
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
            relighter = Relighter.load(model, threads=threads, low_memory=low_memory)
            task = relighter.prepare(loaded, lighting.guides, lighting.negative, options)
            del loaded, lighting  # gigabytes that have served, of a large photograph
            pictures = relit(relighter, task, each)
        if each:
            facts, summary = write_sheet(pictures, mask, captions, output, animation)
        else:
            (picture,) = pictures
            write_image(output, picture.image)
            if shadow_out is not None:
                write_image(shadow_out, shadow_of(picture.guides))
            facts, summary = picture.report, picture.summary
    if report is not None:
        write_json(report, {"scene": name, "output": str(output), **facts})
    print(f"{output}: {summary}", file=sys.stderr)
