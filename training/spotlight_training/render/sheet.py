"""Contact sheets: one row a scene, so that a person can judge a data set at a glance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from spotlight_spec import replacing

from .mesh import Array
from .record import SceneRecord

CELL = 160
COLUMNS = (
    "image",
    "background",
    "albedo",
    "normal",
    "depth",
    "mask",
    "shadow",
    "ambient",
    "second light",
    "its shadow",
)
_TITLE = 18


def sheet_row(record: SceneRecord) -> Array:
    """Return one scene's cells side by side, uint8 RGB, shape (CELL, CELL * len(COLUMNS), 3)."""
    names = list(record.lights)
    first, second = names[0], names[min(1, len(names) - 1)]
    maps = record.composed()
    near, far = float(maps.depth.min()), float(np.percentile(maps.depth, 98))
    cells = [
        record.image({first: 1.0}),
        record.image({first: 1.0}, with_object=False),
        maps.albedo ** (1 / 2.2),
        maps.normal * 0.5 + 0.5,
        _grey(1.0 - (maps.depth - near) / max(far - near, 1e-6)),
        _marked(record.object.alpha, record.footprint_depth > 0),
        _grey(record.shadows[first]),
        record.image({}, ambient=1.0),
        record.image({second: 1.0}),
        _grey(record.shadows[second]),
    ]
    shrunk = [
        cv2.resize(
            np.ascontiguousarray(cell, dtype=np.float32), (CELL, CELL), interpolation=cv2.INTER_AREA
        )
        for cell in cells
    ]
    return np.round(np.clip(np.concatenate(shrunk, axis=1), 0, 1) * 255).astype(np.uint8)


def write_sheet(path: Path, rows: Sequence[Array]) -> None:
    """Write rows below a line of column titles, replacing the file in one step."""
    title = np.full((_TITLE, rows[0].shape[1], 3), 255, dtype=np.uint8)
    for i, name in enumerate(COLUMNS):
        cv2.putText(
            title,
            name,
            (i * CELL + 4, 13),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.4,
            (0, 0, 0),
            1,
            cv2.LINE_AA,
        )
    picture = np.concatenate([title, *rows], axis=0)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, keep_suffix=True) as partial:
        cv2.imwrite(str(partial), picture[..., ::-1])


def _grey(plane: Array) -> Array:
    return np.repeat(np.clip(plane, 0, 1)[..., None], 3, axis=2)


def _marked(mask: Array, footprint: Array) -> Array:
    """Return the mask in grey with the footprint in red."""
    return np.where(footprint[..., None], np.array([1.0, 0.2, 0.1]), _grey(mask) * 0.8)
