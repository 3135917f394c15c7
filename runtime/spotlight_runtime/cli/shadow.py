"""``spotlight shadow``."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.lights import Light, Vector
from spotlight_runtime.imaging.images import check_target, read_image, write_image
from spotlight_runtime.scenes.scene import Scene
from spotlight_runtime.shadows.scribble import clean_scribble
from spotlight_runtime.shadows.shadow import ShadowCaster

__all__ = ["shadow"]


def shadow(
    scene: Annotated[
        Path, typer.Argument(help="Scene folder or zip: scene.json, or the published layout.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Guiding shadow to write: white is shadow.")
    ],
    azimuth: Annotated[
        float | None,
        typer.Option(
            help="Where the light is, in degrees round the object: 0 right, 90 behind it, "
            "180 left, 270 in front. The shadow falls to the other side."
        ),
    ] = None,
    elevation: Annotated[
        float | None,
        typer.Option(help="How high the light is, in degrees: 20 long shadow, 70 short."),
    ] = None,
    radius: Annotated[
        float,
        typer.Option(
            help="Size of the light, and so softness of the shadow, in object sizes; 0 is hard. "
            "With --directional, degrees (the sun: 0.27)."
        ),
    ] = 1.0,
    distance: Annotated[float, typer.Option(help="Of the light, in object sizes.")] = 10.0,
    directional: Annotated[
        bool, typer.Option("--directional", help="A light infinitely far away, like the sun.")
    ] = False,
    light_position: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Instead of azimuth, elevation and distance, in metres: right, away, up from the "
            "object's foot; in the camera's frame right, up, towards you from the camera.",
        ),
    ] = None,
    frame: Annotated[
        Literal["world", "camera"], typer.Option(help="What is level: the floor, or the camera.")
    ] = "world",
    samples: Annotated[
        int | None, typer.Option(help="Rays a pixel in the soft edge.", show_default="64")
    ] = None,
    negative: Annotated[
        Path | None, typer.Option(help="Also write the shadow of the opposite light here.")
    ] = None,
    scribble: Annotated[
        Path | None,
        typer.Option(help="Instead of a light, a drawing of any size: white is shadow."),
    ] = None,
    softness: Annotated[
        float, typer.Option(help="With --scribble: pixels over which its edges fade.")
    ] = 0.0,
    invert: Annotated[
        bool, typer.Option("--invert", help="With --scribble: black shadow on white paper.")
    ] = False,
) -> None:
    """Cast a scene's guiding shadow, or clean a drawn one.

    Examples
    --------
    spotlight shadow chair/ --azimuth 135 --elevation 45 -o left.png --negative right.png

    spotlight shadow chair/ --azimuth 20 --elevation 30 --directional --radius 0.27 -o sun.png

    spotlight shadow chair/ --scribble drawing.png --softness 6 -o drawn.png
    """
    for target in (output, negative):
        if target is not None:
            check_target(target)
    light = None
    if scribble is None:
        light = Light(
            azimuth=azimuth,
            elevation=elevation,
            radius=radius,
            distance=None if directional else distance,
            position=None if light_position is None else _position(light_position),
            frame=frame,
        )
    elif azimuth is not None or elevation is not None or light_position is not None:
        raise InvalidInputError("shadow: expected a light or --scribble, got both; leave one out")
    elif negative is not None:
        raise InvalidInputError(
            "shadow: --negative is the opposite light's shadow, which a scribble has not; draw a "
            "second one"
        )
    loaded = Scene.load(scene)
    if light is None:
        assert scribble is not None
        drawing = read_image(scribble)
        cleaned = clean_scribble(drawing, loaded.object_mask, softness=softness, invert=invert)
        write_image(output, cleaned)
        print(f"{output}: {(cleaned > 0.5).mean():.1%} of the picture dark", file=sys.stderr)
        return
    caster = ShadowCaster(loaded)
    for target, each in ((output, light), (negative, light.opposite())):
        if target is not None:
            _write(caster, each, target, samples)


def _write(caster: ShadowCaster, light: Light, target: Path, samples: int | None) -> None:
    start = time.perf_counter()
    cast = caster.cast(light, samples=samples)
    seconds = time.perf_counter() - start
    write_image(target, cast.shadow)
    dark = float((cast.shadow > 0.5).mean())
    print(f"{target}: {dark:.1%} of the picture dark, {seconds:.2f} s", file=sys.stderr)
    if cast.notice is not None:
        print(f"spotlight: note: {cast.notice}", file=sys.stderr)


def _position(text: str) -> Vector:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InvalidInputError(
            f"--light-position: expected three numbers as 1.5,-2,3, got {text!r}"
        ) from error
    return x, y, z
