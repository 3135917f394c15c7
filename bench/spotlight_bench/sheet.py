"""What an evaluation looks like: a qualitative sheet and an eight-direction animation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from spotlight_bench.dataset import AZIMUTHS, DOMINANT, Direction, TestScene
from spotlight_bench.evaluate import picture_file
from spotlight_bench.methods import OURS, Method
from spotlight_bench.results import Result
from spotlight_runtime import read_image
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import linear_to_srgb

__all__ = ["SHEET_METHODS", "animate", "guide", "qualitative_sheet", "sheet_rows"]

SHEET_METHODS: Final = ("pasted", "no-control", "sdedit")
"""Baselines on the sheet, in order; then methods from folders, then ours."""
CAPTION: Final = 22
"""Pixels of the line of text over a picture."""
GAP: Final = 4
FRAME_MILLISECONDS: Final = 450
PAPER_WHITE: Final = (255, 255, 255)
INK: Final = (20, 20, 20)
GUIDE_OPACITY: Final = 0.7
GUIDE_GREY: Final = 0.55


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One picture on a sheet with the line above it; without a picture, an empty place."""

    caption: str
    picture: FloatArray | None


def guide(test: TestScene, direction: Direction) -> FloatArray:
    """The photograph darkened by the guiding shadow, with the object in grey; sRGB, (H, W, 3)."""
    scene = test.scene
    lit = 1.0 - GUIDE_OPACITY * direction.shadow * (1.0 - scene.object_mask)
    photograph = linear_to_srgb(scene.background) * lit[..., None]
    mask = scene.object_mask[..., None]
    return np.asarray(photograph * (1.0 - mask) + GUIDE_GREY * mask, dtype=np.float32)


def sheet_rows(scenes: Sequence[TestScene]) -> list[tuple[TestScene, Direction]]:
    """Rows of the sheet: of each scene its dominant light, then one of the azimuths in turn."""
    rows = []
    for index, test in enumerate(scenes):
        by_name = {direction.name: direction for direction in test.directions}
        wanted = (DOMINANT, AZIMUTHS[(1 + 3 * index) % len(AZIMUTHS)])
        rows += [(test, by_name[name]) for name in wanted if name in by_name]
    return rows


def qualitative_sheet(
    path: Path,
    output: Path,
    rows: Sequence[tuple[TestScene, Direction]],
    methods: Sequence[Method],
    results: Sequence[Result],
) -> None:
    """Write a PNG: a row a direction; guiding shadow, baselines, ours, truth.

    Parameters
    ----------
    path : Path
    output : Path
        Folder of the run, where the methods' pictures lie.
    rows : sequence of (TestScene, Direction)
        See `sheet_rows`.
    methods : sequence of Method
        Those of the run.
    results : sequence of Result
        PSNR is written over the pictures.
    """
    psnr = {r.key: r.scores["full"]["psnr"] for r in results if "full" in r.scores}
    shown = _columns(methods)
    lines = []
    for test, direction in rows:
        panels = [Panel(_told(direction), guide(test, direction))]
        for method in shown:
            found = psnr.get((test.name, direction.name, method.name))
            told = "" if found is None else f"  {found:.1f} dB"
            picture = _stored(output, method, test, direction)
            panels.append(Panel(method.name + told, picture))
        panels.append(Panel("no truth" if direction.truth is None else "truth", direction.truth))
        lines.append(_strip(panels, test.scene.size))
    _stack(lines).save(path)


def animate(
    path: Path, output: Path, tests: Sequence[TestScene], methods: Sequence[Method]
) -> bool:
    """Write an animation of the eight azimuths: guiding shadow, ours (or the first), truth.

    Parameters
    ----------
    path : Path
        ``.webp``, ``.gif`` or ``.png`` (animated).
    output : Path
        Folder of the run.
    tests : sequence of TestScene
        A row each; those without eight azimuths are left out.
    methods : sequence of Method

    Returns
    -------
    bool
        Whether there was anything to show.
    """
    turning = [test for test in tests if {d.name for d in test.directions} >= set(AZIMUTHS)]
    chosen = next((m for m in methods if m.name == OURS), methods[0])
    frames = []
    for name in AZIMUTHS if turning else ():
        lines = []
        for test in turning:
            (direction,) = (d for d in test.directions if d.name == name)
            panels = [
                Panel(_told(direction), guide(test, direction)),
                Panel(chosen.name, _stored(output, chosen, test, direction)),
            ]
            if direction.truth is not None:
                panels.append(Panel("truth", direction.truth))
            lines.append(_strip(panels, test.scene.size))
        frames.append(_stack(lines))
    if not frames:
        return False
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=FRAME_MILLISECONDS, loop=0
    )
    return True


def _told(direction: Direction) -> str:
    if direction.name == DOMINANT:
        return "shadow of the scene's light"
    return f"shadow at azimuth {AZIMUTHS.index(direction.name) * 45}°"


def _columns(methods: Sequence[Method]) -> list[Method]:
    named = {method.name: method for method in methods}
    baselines = [named[name] for name in SHEET_METHODS if name in named]
    foreign = [method for method in methods if method.kind == "folder"]
    ours = [named[OURS]] if OURS in named else []
    return [*baselines, *foreign, *ours] or list(methods)


def _stored(
    output: Path, method: Method, test: TestScene, direction: Direction
) -> FloatArray | None:
    path = picture_file(output, method.name, test.name, direction.name)
    return read_image(path) if path.is_file() else None


def _strip(panels: Sequence[Panel], size: tuple[int, int]) -> Image.Image:
    height, width = size
    step = width + GAP
    strip = Image.new("RGB", (step * len(panels) - GAP, height + CAPTION), PAPER_WHITE)
    draw = ImageDraw.Draw(strip)
    font = ImageFont.load_default(size=14)
    for index, panel in enumerate(panels):
        draw.text((index * step + 2, 3), panel.caption, fill=INK, font=font)
        if panel.picture is not None:
            pixels = np.round(np.clip(panel.picture[..., :3], 0.0, 1.0) * 255.0).astype(np.uint8)
            strip.paste(Image.fromarray(pixels), (index * step, CAPTION))
    return strip


def _stack(strips: Sequence[Image.Image]) -> Image.Image:
    width = max(strip.width for strip in strips)
    stacked = Image.new("RGB", (width, sum(s.height + GAP for s in strips) - GAP), PAPER_WHITE)
    top = 0
    for strip in strips:
        stacked.paste(strip, (0, top))
        top += strip.height + GAP
    return stacked
