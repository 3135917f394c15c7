"""Test sets in the published SpotLight layout: scenes, guiding shadows, truths.

One folder a scene, which `Scene.load` reads, with ``shadow_positive_D.png`` and
``shadow_negative_D.png`` for each direction D:

* ``gt_dir``, the photograph's dominant light (*reference-based*): its truth is the layer
  ``composite`` of the scene's bundle.
* ``0000`` to ``0007``, azimuths 45° apart (*user-controlled*): the published set has no truth for
  them; a rendered set has ``truth_D.exr``, linear RGB of the photograph with the object lit from
  there.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from spotlight_bench.errors import DataError
from spotlight_runtime import Scene, read_image
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import linear_to_srgb, luma

__all__ = [
    "AZIMUTHS",
    "DOMINANT",
    "Direction",
    "TestScene",
    "azimuth_scenes",
    "find_scenes",
    "fingerprint",
    "has_directions",
    "load_scene",
]

DOMINANT: Final = "gt_dir"
AZIMUTHS: Final = tuple(f"{index:04d}" for index in range(8))
_SCENE_FILES: Final = ("*_bundle0001.exr", "scene.json")
_HEAD: Final = 4096
"""Bytes of each file in a fingerprint: a whole set is gigabytes."""


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """One light to relight a scene by.

    Attributes
    ----------
    name : str
        ``gt_dir`` or ``0000`` to ``0007``.
    shadow : ndarray of float32, shape (H, W)
        Guiding shadow, 1 = fully shadowed.
    opposite : ndarray of float32, shape (H, W), or None
        Shadow of the opposite light, where the set has one.
    truth : ndarray of float32, shape (H, W, 3), or None
        sRGB-encoded, in [0, 1].
    """

    name: str
    shadow: FloatArray
    opposite: FloatArray | None
    truth: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class TestScene:
    """A scene and the directions it is to be relit by."""

    __test__ = False  # not a test case, whatever its name begins with

    folder: Path
    scene: Scene
    directions: tuple[Direction, ...]

    @property
    def name(self) -> str:
        """Name of the scene's folder, by which results and pictures go."""
        return self.folder.name

    @property
    def truths(self) -> tuple[FloatArray, ...] | None:
        """The truths of all eight azimuths in order, if every one is there."""
        known = {direction.name: direction.truth for direction in self.directions}
        found = [known.get(name) for name in AZIMUTHS]
        return None if any(truth is None for truth in found) else tuple(found)  # type: ignore[arg-type]


def find_scenes(data: Path) -> tuple[Path, ...]:
    """Folders of the scenes below ``data``, or ``data`` itself, sorted by name.

    Raises
    ------
    DataError
        If there is none; the message says how to come by some.
    """
    folders = (
        [data, *sorted(path for path in data.iterdir() if path.is_dir())] if _there(data) else []
    )
    found = tuple(f for f in folders if any(any(f.glob(name)) for name in _SCENE_FILES))
    if not found:
        raise DataError(
            f"{data}: expected folders with <name>_bundle0001.exr, found none. Download the "
            "published test set and name it with --data, or render one: `spotlight-train render "
            "--split test --evaluation --count 210 -o data`, then `spotlight-train export-testset "
            "data/test -o testset`"
        )
    return found


def fingerprint(data: Path) -> str:
    """sha256 over the names, sizes and first bytes of all files of a test set's scenes.

    Scenes have the same names in every rendered set, compressed pictures hardly ever their sizes.

    Raises
    ------
    DataError
        If there is no scene.
    """
    digest = hashlib.sha256()
    for folder in find_scenes(data):
        for path in sorted(path for path in folder.iterdir() if path.is_file()):
            digest.update(f"{folder.name}/{path.name} {path.stat().st_size}\n".encode())
            with path.open("rb") as file:
                digest.update(file.read(_HEAD))
    return digest.hexdigest()


def has_directions(folder: Path, names: tuple[str, ...]) -> bool:
    """Whether the scene has a guiding shadow for every one of these directions."""
    return all(_shadow_file(folder, "positive", name).is_file() for name in names)


def load_scene(folder: Path, names: tuple[str, ...]) -> TestScene:
    """Read a scene with these directions.

    Raises
    ------
    DataError
        If a guiding shadow is missing, or a shadow or truth has another size than the scene.
    SpotLightError
        If the scene cannot be read.
    """
    scene = Scene.load(folder)
    return TestScene(folder, scene, tuple(_direction(folder, scene, name) for name in names))


def azimuth_scenes(data: Path, most: int) -> list[TestScene]:
    """Read the first scenes that have shadows of all eight azimuths, with these directions.

    Raises
    ------
    DataError
        If there is none.
    """
    folders = [folder for folder in find_scenes(data) if has_directions(folder, AZIMUTHS)][:most]
    if not folders:
        raise DataError(f"{data}: expected scenes with shadows of eight azimuths, found none")
    return [load_scene(folder, AZIMUTHS) for folder in folders]


def _direction(folder: Path, scene: Scene, name: str) -> Direction:
    positive = _shadow_file(folder, "positive", name)
    if not positive.is_file():
        raise DataError(
            f"{positive}: expected the guiding shadow of direction {name}, found no file; cast it "
            "(`spotlight shadow`), or take the scene out of the set"
        )
    negative = _shadow_file(folder, "negative", name)
    return Direction(
        name,
        shadow=_read_shadow(positive, scene.size),
        opposite=_read_shadow(negative, scene.size) if negative.is_file() else None,
        truth=_truth(folder, scene, name),
    )


def _truth(folder: Path, scene: Scene, name: str) -> FloatArray | None:
    if name == DOMINANT:
        return None if scene.truth is None else linear_to_srgb(scene.truth)
    path = folder / f"truth_{name}.exr"
    if not path.is_file():
        return None
    pixels = read_image(path)
    if pixels.shape[:2] != scene.size or pixels.ndim != 3:
        raise DataError(
            f"{path}: expected RGB of {scene.size[1]}x{scene.size[0]} pixels as the scene's, got "
            f"shape {pixels.shape}; export the scene again"
        )
    return linear_to_srgb(np.ascontiguousarray(pixels[..., :3]))


def _read_shadow(path: Path, size: tuple[int, int]) -> FloatArray:
    pixels = read_image(path)
    if pixels.ndim == 3:
        pixels = luma(pixels[..., :3]) if pixels.shape[2] >= 3 else pixels[..., 0]
    if pixels.shape != size:
        raise DataError(
            f"{path}: expected {size[1]}x{size[0]} pixels as the scene's, got "
            f"{pixels.shape[1]}x{pixels.shape[0]}; cast the shadow at the scene's size"
        )
    return np.clip(pixels, 0.0, 1.0).astype(np.float32)


def _shadow_file(folder: Path, sign: str, name: str) -> Path:
    return folder / f"shadow_{sign}_{name}.png"


def _there(data: Path) -> bool:
    return data.is_dir()
