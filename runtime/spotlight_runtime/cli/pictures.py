"""Making and writing the pictures a command line asks for."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.cli.lighting import Lighting
from spotlight_runtime.cli.progress import drained, progress_bars
from spotlight_runtime.imaging.picture_files import write_picture
from spotlight_runtime.relighting.guides import GuidingShadow
from spotlight_runtime.relighting.mixing import Mix
from spotlight_runtime.relighting.preview import preview, preview_each
from spotlight_runtime.relighting.relighter import Relighter
from spotlight_runtime.relighting.result import RelightResult
from spotlight_runtime.relighting.sweep import Tile, contact_sheet, make_tile, write_animation
from spotlight_runtime.relighting.tasks import Task
from spotlight_runtime.scenes.scene import Scene

__all__ = ["Picture", "relit", "shadow_of", "sketches", "write_sheet"]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture to write.

    Attributes
    ----------
    image : ndarray of float32, shape (H, W, 3)
        sRGB-encoded.
    guides : tuple of GuidingShadow
        What guided it.
    report : dict
        What is known of how it was made, for JSON.
    summary : str
        The same for a person, in half a line.
    """

    image: FloatArray
    guides: tuple[GuidingShadow, ...]
    report: dict[str, Any]
    summary: str


def sketches(scene: Scene, lighting: Lighting, each: bool) -> Iterator[Picture]:
    """Previews: all lights in one picture, or each in one of its own."""
    start = time.perf_counter()
    made = preview_each(scene, lighting.guides) if each else iter([preview(scene, lighting.guides)])
    for sketch in made:
        summary = f"preview, {time.perf_counter() - start:.1f} s"
        yield Picture(sketch.image, sketch.guides, {"preview": True}, summary)


def relit(relighter: Relighter, task: Task, each: bool) -> Iterator[Picture]:
    """Relights: all lights in one picture, or each in one of its own."""
    with progress_bars() as show:
        if not each:
            yield _finished(drained(relighter.start(task), show))
            return
        for one in relighter.start_each(task):
            if isinstance(one, RelightResult):
                yield _finished(one)
            else:
                show(one)


def write_sheet(
    pictures: Iterator[Picture],
    mask: FloatArray,
    captions: Sequence[str],
    output: Path,
    animation: Path | None,
) -> tuple[dict[str, Any], str]:
    """Write the contact sheet, and the animation where one is wanted.

    Returns
    -------
    report : dict
        For JSON.
    summary : str
        For a person.
    """
    tiles: list[Tile] = []
    reports: list[dict[str, Any]] = []
    summary = ""
    for picture, caption in zip(pictures, captions):
        shadow = picture.guides[0].positive
        tiles.append(make_tile(picture.image, shadow, mask, caption))
        reports.append({"light": caption, **picture.report})
        summary = picture.summary
    write_picture(output, contact_sheet(tiles))
    if animation is not None:
        write_animation(animation, [tile.picture for tile in tiles])
    return {"pictures": reports}, f"{len(tiles)} lights; the last: {summary}"


def shadow_of(guides: tuple[GuidingShadow, ...]) -> FloatArray:
    """The guiding shadow of a picture; of several lights, as they add up."""
    together = Mix.of(guides).sum([guide.positive[..., None].repeat(3, 2) for guide in guides])
    return together if len(guides) > 1 else guides[0].positive


def _finished(result: RelightResult) -> Picture:
    seconds = sum(result.timings.values())
    predicted = result.plan.seconds
    foretold = "" if predicted is None else f" (predicted {predicted:.1f})"
    summary = (
        f"{result.plan.name} plan, {result.evaluations} evaluations, {seconds:.1f} s{foretold}"
    )
    return Picture(result.image, result.guides, result.report(), summary)
