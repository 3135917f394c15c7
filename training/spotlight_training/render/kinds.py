"""Which object kinds, environment images and seeds belong to which split.

A split sees only its own inserted-object kinds, so that evaluation meets shapes that training never
did.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import PurePosixPath

import numpy as np

from . import furnishings as g
from . import furniture as f
from . import simple_kinds as s
from . import turned_kinds as t
from .mesh import Shape

Generator = Callable[[np.random.Generator], Shape]

SPLITS = ("train", "val", "test")

OBJECT_KINDS: dict[str, dict[str, Generator]] = {
    "train": {
        "block": s.block,
        "drum": s.drum,
        "cone": s.cone,
        "ring": s.ring,
        "knot": s.knot,
        "capsule": s.capsule,
        "ball": s.ball,
        "crystal": s.crystal,
        "vase": t.vase,
        "bottle": t.bottle,
        "star": s.star,
        "gear": s.gear,
        "heart": s.heart,
        "wedge": s.wedge,
        "smooth_blob": s.smooth_blob,
        "lumpy_blob": s.lumpy_blob,
        "chair": f.chair,
        "sofa": f.sofa,
        "table": f.table,
        "stool": f.stool,
        "shelf": f.shelf,
        "cabinet": f.cabinet,
        "floor_lamp": g.floor_lamp,
        "plant": g.plant,
        "bear": g.bear,
        "stack": g.stack,
    },
    "val": {"goblet": t.goblet, "cross": s.cross, "spiky_blob": s.spiky_blob, "bench": f.bench},
    "test": {
        "bowl": t.bowl,
        "pawn": t.pawn,
        "arrow": s.arrow,
        "ridged_blob": s.ridged_blob,
        "armchair": f.armchair,
        "pedestal_table": f.pedestal_table,
        "desk_lamp": g.desk_lamp,
    },
}

# How often a kind is drawn, where not 1: furniture is what people insert most, and varies most.
KIND_WEIGHTS = {
    "chair": 2.0,
    "sofa": 2.0,
    "table": 1.5,
    "stool": 1.5,
    "shelf": 1.5,
    "cabinet": 2.0,
    "plant": 1.5,
    "bear": 1.5,
    "stack": 2.0,
    "vase": 1.5,
    "bottle": 1.5,
    "smooth_blob": 1.5,
    "lumpy_blob": 1.5,
    "armchair": 2.0,
}

# Metres along the longest side; furniture in its own size, the rest chosen so that a camera at eye
# height sees it well.
SIZES = {
    "chair": (0.8, 1.0),
    "sofa": (1.2, 1.6),
    "table": (0.6, 1.1),
    "stool": (0.45, 0.75),
    "shelf": (0.8, 1.4),
    "cabinet": (0.6, 1.0),
    "floor_lamp": (0.9, 1.4),
    "plant": (0.5, 0.9),
    "bench": (0.9, 1.4),
    "armchair": (0.75, 1.0),
    "pedestal_table": (0.55, 0.85),
}
DEFAULT_SIZE = (0.3, 0.85)

# Small enough to stand on a table; furniture never does.
FLOOR_ONLY = frozenset(SIZES) - {"plant"}

HDRIS: dict[str, tuple[str, ...]] = {
    "train": ("city", "forest", "interior", "night", "studio", "sunset"),
    "val": ("courtyard", "sunrise"),
    "test": ("courtyard", "sunrise"),
}

FILE_SHARES = ("val", "test", *8 * ("train",))
"""Splits by the remainder of an external object's hash."""


def file_split(name: str) -> str:
    """Return the split of an external object, by a hash of its name.

    Parameters
    ----------
    name : str
        Relative path of its file. The name is that of the outermost folder, or else the file's
        without its ending, so that what is stored in several formats stays together.
    """
    own = PurePosixPath(PurePosixPath(name).parts[0]).stem
    digest = hashlib.sha256(own.encode()).digest()
    return FILE_SHARES[int.from_bytes(digest[:4]) % len(FILE_SHARES)]


def generator(kind: str) -> Generator:
    """Return the generator of an object kind, whatever its split."""
    for kinds in OBJECT_KINDS.values():
        if kind in kinds:
            return kinds[kind]
    known = ", ".join(sorted(k for kinds in OBJECT_KINDS.values() for k in kinds))
    raise KeyError(
        f"object kind: expected one of {known}; got {kind!r}. "
        "Re-render the scene with this version."
    )
