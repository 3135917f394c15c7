"""Measures what the stages of a relight cost on this machine, in about two seconds.

Whole relights of made-up scenes at three sizes are run and their own stopwatches read, so what is
predicted later is what was measured here, by the same code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.planning.costs import Costs, Line
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.relighting.result import RelightResult
from spotlight_runtime.scenes.scene import Intrinsics, Scene
from spotlight_spec import BackboneSpec

__all__ = ["made_up_scene", "measure_costs"]

Relight = Callable[[Scene, FloatArray, RelightOptions], RelightResult]

STEPS: Final = 4
"""Against a single one: what a pass's first evaluation takes longer is told apart."""
REUSE: Final = 3
"""As plans have it: a shallow evaluation after another is quicker than one after a whole one."""
REPEATS: Final = 2
"""The quicker counts: what comes between in so short a time only ever adds to it."""
LARGE: Final = 4
"""Sides of the backbone's size in a photograph that is diffused in a window."""


def measure_costs(spec: BackboneSpec, relight: Relight, *, reusable: bool = False) -> Costs:
    """Measure.

    Parameters
    ----------
    spec : BackboneSpec
    relight : callable
        ``relight(scene, shadow, options)``, remembering nothing.
    reusable : bool
        Whether the model predicts from an earlier step's deep features, too.

    Returns
    -------
    Costs
    """
    half, whole = spec.size // 2, spec.size

    def run(side: int, steps: int = 1, reuse: int = 1, **how: Any) -> dict[str, float]:
        scene, shadow = made_up_scene(side)
        options = RelightOptions(steps=steps, reuse=reuse, skip=False, **how)
        repeats = REPEATS if side <= whole else 1
        runs = [relight(scene, shadow, options).timings for _ in range(repeats)]
        return {stage: min(timings[stage] for timings in runs) for stage in runs[0]}

    # Opens the sessions; what it takes counts for nothing.
    relight(*made_up_scene(half), RelightOptions(steps=REUSE, reuse=REUSE, skip=False))
    small, full, large = run(half), run(whole), run(LARGE * whole)
    tight = run(whole, window="tight")
    scale = spec.latent.downscale
    latents = [float((side // scale) ** 2) for side in (half, whole)]

    def line(calls: int, *stages: str) -> Line:
        seconds = [sum(run.get(stage, 0.0) for stage in stages) / calls for run in (small, full)]
        return Line.through(latents, seconds)

    def evaluating(timings: dict[str, float]) -> float:
        """Seconds of the two passes: three evaluations a step."""
        return timings["relight"] + timings["no shadow"]

    each, start, shallow = [], [], []
    for side, one in ((half, small), (whole, full)):
        more = evaluating(run(side, STEPS)) - evaluating(one)
        each.append(max(0.0, more) / (3 * (STEPS - 1)))
        start.append(max(0.0, evaluating(one) - 3 * each[-1]) / 2)
        if reusable:  # all evaluations but the first are shallow
            more = evaluating(run(side, REUSE, REUSE)) - evaluating(one)
            shallow.append(max(0.0, more) / (3 * (REUSE - 1)))
    return Costs(
        evaluation=Line.through(latents, each),
        start=Line.through(latents, start),
        shallow=Line.through(latents, shallow) if reusable else Line(0.0, 0.0),
        condition=line(3, "condition"),
        encode=line(2, "encode"),
        decode=line(2, "decode", "denoise"),
        frame=Line.through(
            [float(half**2), float(whole**2)], [small["composite"], full["composite"]]
        ),
        window=Line.through(
            [float(whole**2), float((LARGE * whole) ** 2)],
            [tight["composite"], large["composite"]],
        ),
    )


def made_up_scene(side: int) -> tuple[Scene, FloatArray]:
    """A ball on a plain floor, with all maps, for any backbone; and its shadow to the right.

    Parameters
    ----------
    side : int
        In pixels.

    Returns
    -------
    scene : Scene
        Its own mirror image.
    shadow : ndarray of float32, shape (side, side)
    """
    rows, columns = (np.mgrid[:side, :side].astype(np.float32) + 0.5) / np.float32(side)

    def disc(row: float, column: float, radius: float) -> FloatArray:
        inside = np.hypot(rows - row, columns - column) < radius
        return inside.astype(np.float32)

    def maps(cover: FloatArray, tone: float) -> Intrinsics:
        normal = np.zeros((side, side, 3), np.float32)
        normal[..., 2] = cover
        return Intrinsics(
            albedo=np.repeat(cover[..., None], 3, axis=2) * np.float32(tone),
            normal=normal,
            depth=cover * (np.float32(3.0) - rows),
            roughness=cover * np.float32(0.6),
            metallic=np.zeros_like(cover),
        )

    ball = disc(0.45, 0.5, 0.2)
    background = np.repeat((0.3 + 0.3 * rows)[..., None], 3, axis=2).astype(np.float32)
    scene = Scene(background, maps(np.ones_like(ball), 0.6), maps(ball, 0.4), ball)
    return scene, disc(0.6, 0.65, 0.15) * (np.float32(1.0) - ball)
