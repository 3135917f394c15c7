"""Renders a range of seeds into a folder.

Resumable, logged, with a contact sheet that grows as it goes.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .denoise import Denoiser
from .pipeline import RenderOptions, render
from .record import SceneRecord, is_whole, record_path
from .scenes import SceneOptions, describe
from .sheet import sheet_row, write_sheet

logger = logging.getLogger(__name__)

SHEET_ROWS = 12


@dataclass(frozen=True)
class Progress:
    """One finished seed.

    Its record's path, the seconds it took (0 if it was there already), and how many are done.
    """

    path: Path
    seconds: float
    done: int
    total: int
    skipped: bool


def render_range(
    split: str,
    seeds: range,
    folder: Path,
    scene_options: SceneOptions,
    options: RenderOptions,
    denoiser: Denoiser,
) -> Iterator[Progress]:
    """Render scenes one by one and yield after each; a scene whose record is whole is skipped.

    The contact sheet `folder/split/sheet_SSSSSS.png` shows the latest twelve scenes rendered; a new
    one is begun for every hundred seeds. `folder/split/render.jsonl` gets a line a scene.
    """
    rows: list = []
    for done, seed in enumerate(seeds, start=1):
        path = record_path(folder, split, seed)
        if is_whole(path):
            yield Progress(path, 0.0, done, len(seeds), skipped=True)
            continue
        start = time.perf_counter()
        scene = describe(split, seed, scene_options)
        record = render(scene, options, denoiser)
        record.save(path)
        seconds = time.perf_counter() - start
        _log(folder / split / "render.jsonl", seed, record, path, seconds)
        rows = [*rows[-(SHEET_ROWS - 1) :], sheet_row(record)]
        write_sheet(folder / split / f"sheet_{seed // 100 * 100:06d}.png", rows)
        logger.info("%s in %.1f s (%d of %d)", path.name, seconds, done, len(seeds))
        yield Progress(path, seconds, done, len(seeds), skipped=False)


def _log(path: Path, seed: int, record: SceneRecord, where: Path, seconds: float) -> None:
    line = {
        "seed": seed,
        "seconds": round(seconds, 2),
        "bytes": where.stat().st_size,
        "subject": record.description.subject.kind,
        "mask_share": round(float(record.object.alpha.mean()), 4),
        "shadow_share": {
            name: round(float(shadow.mean()), 4) for name, shadow in record.shadows.items()
        },
    }
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")
