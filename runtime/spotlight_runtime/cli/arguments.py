"""Arguments that several commands share: which scene, which light, and how to relight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from spotlight_runtime.networks import models
from spotlight_runtime.planning.ladder import PlanName
from spotlight_runtime.planning.options import WindowMode
from spotlight_runtime.relighting.lights_file import DEFAULT_ELEVATION
from spotlight_runtime.relighting.tasks import Wishes

__all__ = [
    "Azimuth",
    "Beta",
    "Budget",
    "Denoise",
    "Detail",
    "Directional",
    "Distance",
    "Elevation",
    "Engine",
    "Fidelity",
    "Gamma",
    "GuidanceInterval",
    "Invert",
    "LightName",
    "LightsFile",
    "Model",
    "Named",
    "Negative",
    "PlainSteps",
    "Radius",
    "Reuse",
    "SceneFolder",
    "Seed",
    "Shadow",
    "Softness",
    "Solver",
    "Steps",
    "Sweep",
    "Threads",
    "Window",
    "wishes",
]

LIGHT = "Light (give one)"
FURTHER = "Light, further"
METHOD = "Method"
MACHINE = "Machine"

SceneFolder = Annotated[
    Path, typer.Argument(help="Scene folder or zip: scene.json, or the published layout.")
]
Azimuth = Annotated[
    float | None,
    typer.Option(
        help="Where the light is, in degrees round the object: 0 right, 90 behind it, 180 "
        "left, 270 towards the camera.",
        rich_help_panel=LIGHT,
    ),
]
Shadow = Annotated[
    Path | None,
    typer.Option(
        help="The light's shadow as a grey image, white is shadow. One of another size than "
        "the scene's is taken for a scribble and cleaned.",
        rich_help_panel=LIGHT,
    ),
]
LightName = Annotated[
    str | None,
    typer.Option(
        help="A light whose shadow lies ready in the scene, by name: gt_dir, 0003.",
        rich_help_panel=LIGHT,
    ),
]
LightsFile = Annotated[
    Path | None,
    typer.Option(
        help='Several lights as JSON: [{"azimuth": 30, "elevation": 50, "weight": 2, '
        '"colour": [1, 0.8, 0.6]}, …].',
        rich_help_panel=LIGHT,
    ),
]
Sweep = Annotated[
    int | None,
    typer.Option(
        help="So many lights all round, each a picture of its own on a contact sheet.",
        rich_help_panel=LIGHT,
    ),
]
Elevation = Annotated[
    float | None,
    typer.Option(
        help="Degrees above the floor.",
        show_default=f"{DEFAULT_ELEVATION:g}",
        rich_help_panel=FURTHER,
    ),
]
Radius = Annotated[
    float | None,
    typer.Option(
        help="Size of the light, in sizes of the object: the larger, the softer the shadow.",
        show_default="1",
        rich_help_panel=FURTHER,
    ),
]
Distance = Annotated[
    float | None,
    typer.Option(
        help="Of the light, in sizes of the object.", show_default="10", rich_help_panel=FURTHER
    ),
]
Directional = Annotated[
    bool,
    typer.Option(
        "--directional",
        help="A light infinitely far away, like the sun; --radius is then in degrees (0.27).",
        rich_help_panel=FURTHER,
    ),
]
Softness = Annotated[
    float | None,
    typer.Option(
        help="Of a drawn --shadow: pixels over which its edges fade.", rich_help_panel=FURTHER
    ),
]
Invert = Annotated[
    bool,
    typer.Option(
        "--invert", help="The drawn --shadow is black on white paper.", rich_help_panel=FURTHER
    ),
]
Negative = Annotated[
    str | None,
    typer.Option(
        help="What the guidance contrasts with: opposite (light), none, or an image.",
        show_default="opposite; none for --shadow",
        rich_help_panel=FURTHER,
    ),
]

Named = Annotated[
    PlanName | None,
    typer.Option(
        "--plan",
        help="What to run: exact, or one that trades a measured loss for time. Options below "
        "change what it says.",
        show_default="exact",
        rich_help_panel=METHOD,
    ),
]
Budget = Annotated[
    float | None,
    typer.Option(
        help="Seconds it may take here: the most accurate plan that fits. Measures this machine "
        "the first time, for about two seconds.",
        rich_help_panel=METHOD,
    ),
]
Gamma = Annotated[
    float | None,
    typer.Option(
        help="How strongly the shadow steers the shading; 1 is not at all.",
        show_default="3",
        rich_help_panel=METHOD,
    ),
]
Beta = Annotated[
    float | None,
    typer.Option(
        help="How strongly the shadow enters the picture.",
        show_default="0.05",
        rich_help_panel=METHOD,
    ),
]
Seed = Annotated[
    int | None,
    typer.Option(help="Same seed, same picture.", show_default="469", rich_help_panel=METHOD),
]
Steps = Annotated[
    int | None,
    typer.Option(
        help="Denoising steps.", show_default="the plan's, or backbone's", rich_help_panel=METHOD
    ),
]
Solver = Annotated[
    Literal["ddim", "dpmpp_2m", "unipc"] | None,
    typer.Option(show_default="the plan's, or ddim", rich_help_panel=METHOD),
]
PlainSteps = Annotated[
    int | None,
    typer.Option(
        help="Steps of the pass without shadow.",
        show_default="the plan's, or as many",
        rich_help_panel=METHOD,
    ),
]
GuidanceInterval = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--guided",  # the whole name does not fit into a terminal's 80 columns
        metavar="FROM TO",
        help="Shares of the steps between which the guidance contrasts (guidance_interval); "
        "outside, half the work.",
        show_default="the plan's, or 0 1",
        rich_help_panel=METHOD,
    ),
]
Reuse = Annotated[
    int | None,
    typer.Option(
        help="Run all of the denoiser in one of so many steps, in the others what is shallow.",
        show_default="the plan's, or 1",
        rich_help_panel=METHOD,
    ),
]
Fidelity = Annotated[
    Literal["paper", "release"] | None,
    typer.Option(
        help="Follow the paper, or the public release to the letter.",
        show_default="paper",
        rich_help_panel=METHOD,
    ),
]
Window = Annotated[
    WindowMode | None,
    typer.Option(
        help="Diffuse a window around object and shadow at the model's scale, the whole frame at "
        "its own, no more than is needed, or that at 5/8 of the scale.",
        show_default="auto",
        rich_help_panel=METHOD,
    ),
]
Detail = Annotated[
    Literal["auto", "renderer", "maps"] | None,
    typer.Option(
        help="Whose detail the object shows: the renderer's pixels, or its shading on the "
        "object's own maps.",
        show_default="maps in a window or of a small model, else the renderer's",
        rich_help_panel=METHOD,
    ),
]
Denoise = Annotated[
    bool | None,
    typer.Option(
        "--denoise/--no-denoise",
        show_default="where the backbone needs it",
        rich_help_panel=METHOD,
    ),
]
Model = Annotated[
    str,
    typer.Option(help="Model name or folder: `spotlight models`.", rich_help_panel=METHOD),
]
Engine = Annotated[
    models.Engine,
    typer.Option(
        help="What computes the networks; OpenVINO (extra openvino) in bfloat16 is quickest for "
        "full-size models where the processor has it.",
        rich_help_panel=MACHINE,
    ),
]
Threads = Annotated[
    int | None,
    typer.Option(help="Threads.", show_default="all this process may use", rich_help_panel=MACHINE),
]


def wishes(**given: Any) -> Wishes:
    """The options that were given; the others are the plan's."""
    return {name: value for name, value in given.items() if value is not None}  # type: ignore[return-value]
