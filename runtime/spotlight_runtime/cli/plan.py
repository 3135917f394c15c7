"""``spotlight plan``."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from spotlight_runtime.cli import arguments as a
from spotlight_runtime.cli.lighting import Asked, choose_lighting
from spotlight_runtime.cli.progress import notices
from spotlight_runtime.planning.plan import Plan
from spotlight_runtime.relighting.relighter import Relighter
from spotlight_runtime.scenes.scene import Scene

__all__ = ["plan"]


def plan(
    scene: a.SceneFolder,
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
    model: a.Model = "mini",
    named: a.Named = None,
    budget: a.Budget = None,
    gamma: a.Gamma = None,
    beta: a.Beta = None,
    steps: a.Steps = None,
    solver: a.Solver = None,
    plain_steps: a.PlainSteps = None,
    guidance_interval: a.GuidanceInterval = None,
    reuse: a.Reuse = None,
    window: a.Window = None,
    engine: a.Engine = "onnxruntime",
    threads: a.Threads = None,
    measure: Annotated[
        bool, typer.Option("--measure", help="Measure this machine again first.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say what a relight would run, what it would leave out and why, and how long it would take.

    Nothing is relit. The first time, the model is measured on this machine for about two seconds.

        spotlight plan chair/ --azimuth 135 --elevation 45

        spotlight plan chair/ --azimuth 135 --budget 1.5 --json
    """
    loaded = Scene.load(scene)
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
    lighting = choose_lighting(scene, loaded, asked)
    wishes = a.wishes(
        plan=named,
        budget=budget,
        gamma=gamma,
        beta=beta,
        steps=steps,
        solver=solver,
        plain_steps=plain_steps,
        guidance_interval=guidance_interval,
        reuse=reuse,
        window=window,
    )
    relighter = Relighter.load(model, engine=engine, threads=threads)
    relighter.calibrated(again=measure)
    with notices():
        made = relighter.plan(loaded, lighting.guides, lighting.negative, **wishes)
    if as_json:
        print(json.dumps(made.report(), indent=2, ensure_ascii=False))
    else:
        Console().print(_table(made))


def _table(made: Plan) -> Table:
    table = Table(title=f"{made.name} plan")
    for column, side in (("effect", "left"), ("", "left"), ("why", "left")):
        table.add_column(column, justify=side)  # type: ignore[arg-type]
    table.add_column("evaluations", justify="right")
    table.add_column("seconds", justify="right")
    for effect in made.effects:
        table.add_row(
            effect.name,
            "on" if effect.on else "off",
            effect.reason + ("" if effect.exact else " (approximate)"),
            str(effect.evaluations or ""),
            f"{effect.seconds:.2f}" if effect.seconds else "",
        )
    table.add_section()
    table.add_row("in all", "", "", str(made.evaluations), f"{made.seconds or 0.0:.2f}")
    return table
