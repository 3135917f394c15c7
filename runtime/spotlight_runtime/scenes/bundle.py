"""SpotLight's own scene bundle: a folder (or zip of one) with ``scene.json`` and its images."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal

import numpy as np

from spotlight_runtime.arrays import FloatArray, sparse_copy
from spotlight_runtime.errors import SceneError, SpotLightError, UnsafePathError
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.geometry.mesh_files import read_mesh, write_mesh
from spotlight_runtime.imaging.decoding import read_bytes
from spotlight_runtime.parallel import in_parallel
from spotlight_runtime.scenes.map_files import (
    MapFile,
    covered_box,
    read_map_file,
    write_map,
    write_part,
    write_reduced,
)
from spotlight_runtime.scenes.scene import MAP_NAMES, AlbedoScale, Intrinsics, Scene
from spotlight_spec import RecordError, alone_in, decode, encode, read_json, replacing, write_json

__all__ = [
    "SCENE_FILE",
    "GeometryFile",
    "MapFile",
    "SceneFile",
    "load_bundle",
    "save_bundle",
]


SCENE_FILE: Final = "scene.json"
MESH_FILE: Final = "object_mesh.npz"


_Row = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class GeometryFile:
    """The object's mesh in a bundle.

    Attributes
    ----------
    file : str
        Path relative to the bundle, inside it: ``.npz`` with ``vertices`` and ``faces``, or a model
        (``.glb``, ``.obj``, …).
    pose : 4 rows of 4 numbers, optional
        From the file's coordinates to camera space, acting on columns.
    """

    file: str
    pose: tuple[_Row, _Row, _Row, _Row] | None = None


@dataclass(frozen=True, slots=True)
class SceneFile:
    """``scene.json``.

    ``background`` has ``image`` and maps, ``object`` has ``mask`` and maps premultiplied by it;
    maps are albedo, normal, depth, roughness and metallic, of which only albedo is required.
    ``albedo_scale`` is `Scene`'s, ``object_geometry`` is what casts shadows, ``ground`` the floor
    in camera space.
    """

    version: Literal[1]
    width: int
    height: int
    background: dict[str, MapFile]
    object: dict[str, MapFile]
    name: str = "scene"
    albedo_scale: AlbedoScale = "known"
    field_of_view: float | None = None
    footprint_depth: MapFile | None = None
    truth: MapFile | None = None
    object_geometry: GeometryFile | None = None
    ground: Ground | None = None

    def __post_init__(self) -> None:
        for owner, maps, image in (
            ("background", self.background, "image"),
            ("object", self.object, "mask"),
        ):
            unknown = set(maps) - {image, *MAP_NAMES}
            missing = {image, "albedo"} - set(maps)
            if unknown or missing:
                raise ValueError(
                    f"{owner}: expected {image} and albedo, and optionally "
                    f"{', '.join(MAP_NAMES[1:])}; missing {sorted(missing)}, "
                    f"unknown {sorted(unknown)}"
                )


def load_bundle(folder: Path) -> Scene:
    """Read a bundle folder; see `Scene.load` for what can be wrong with it."""
    before = _stamp(folder)
    scene = _load_once(folder)
    if before is None or _stamp(folder) != before:
        raise SceneError(
            f"{folder / SCENE_FILE}: the scene was saved again while it was read; load it again"
        )
    return scene


def _stamp(folder: Path) -> tuple[int, int] | None:
    """What tells one save of a bundle from the next."""
    try:
        status = os.stat(folder / SCENE_FILE)
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


def _load_once(folder: Path) -> Scene:
    path = folder / SCENE_FILE
    try:
        record = decode(SceneFile, read_json(path), where=str(path))
    except RecordError as error:
        raise SceneError(str(error)) from error

    def read(entry: MapFile, channels: int) -> FloatArray:
        path = _inside(folder, entry.file)
        return read_map_file(path, entry, channels, (record.height, record.width))

    def read_sparse(entry: MapFile, channels: int) -> FloatArray:
        value = read(entry, channels)
        return value if entry.corner is not None else sparse_copy(value)

    def maps(
        entries: dict[str, MapFile], reader: Callable[[MapFile, int], FloatArray]
    ) -> Intrinsics:
        found = {
            name: reader(entries[name], 3 if name in ("albedo", "normal") else 1)
            for name in MAP_NAMES
            if name in entries
        }
        return Intrinsics(**found)

    return Scene(
        background=read(record.background["image"], 3),
        background_maps=maps(record.background, read),
        object_maps=maps(record.object, read_sparse),
        object_mask=read_sparse(record.object["mask"], 1),
        footprint_depth=read_sparse(record.footprint_depth, 1) if record.footprint_depth else None,
        truth=read(record.truth, 3) if record.truth else None,
        field_of_view=record.field_of_view,
        name=record.name,
        albedo_scale=record.albedo_scale,
        object_mesh=_read_geometry(folder, record.object_geometry),
        ground=record.ground,
    )


def save_bundle(
    scene: Scene,
    folder: Path,
    *,
    photograph: Path | None = None,
    working_side: int | None = None,
    estimated: Collection[str] = MAP_NAMES,
) -> None:
    """Write a bundle; ``scene.json`` goes last, so an interrupted save is not taken for a scene.

    Who saves into the same folder meanwhile waits, so that files of two scenes are not mixed.

    Parameters
    ----------
    scene : Scene
    folder : Path
    photograph : Path, optional
        sRGB-encoded file whose pixels are exactly the scene's background; it is copied.
    working_side : int, optional
        Pixels of the longer side that the estimated maps of the background have details of;
        they are stored accordingly, and not to the bit.
    estimated : collection of str
        Names of those maps.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise SceneError(f"{folder}: expected a folder to save in, found a file") from error
    except OSError as error:
        raise SceneError(f"{folder}: cannot be saved in: {error.strerror or error}") from error
    try:
        with alone_in(folder):
            _save_files(scene, folder, photograph, dict.fromkeys(estimated, working_side))
    except SpotLightError:
        raise
    except OSError as error:
        raise SceneError(f"{folder}: cannot be saved: {error.strerror or error}") from error


def _save_files(
    scene: Scene, folder: Path, photograph: Path | None, sides: Mapping[str, int | None]
) -> None:
    (folder / SCENE_FILE).unlink(missing_ok=True)
    box = covered_box(scene.object_mask)
    jobs: dict[tuple[str, str], Callable[[], MapFile]] = {
        ("object", "mask"): lambda: write_part(folder, "object_mask.png", scene.object_mask, box)
    }
    if photograph is None:
        jobs["background", "image"] = lambda: write_map(folder, "background.exr", scene.background)
    else:
        jobs["background", "image"] = lambda: _copy_photograph(folder, photograph)
    for name, value in _maps_of(scene.background_maps):
        jobs["background", name] = partial(_write_background, folder, name, value, sides.get(name))
    for name, value in _maps_of(scene.object_maps):
        jobs["object", name] = partial(write_part, folder, _file(f"object_{name}"), value, box)
    if scene.footprint_depth is not None:
        foot = scene.footprint_depth
        contact = covered_box(foot)
        jobs["", "footprint"] = lambda: write_part(folder, "footprint_depth.exr", foot, contact)
    if scene.truth is not None:
        jobs["", "truth"] = partial(write_map, folder, "truth.exr", scene.truth)
    files = dict(zip(jobs, in_parallel(lambda job: job(), jobs.values())))
    background = {name: file for (owner, name), file in files.items() if owner == "background"}
    inserted = {name: file for (owner, name), file in files.items() if owner == "object"}
    footprint, truth = files.get(("", "footprint")), files.get(("", "truth"))
    geometry = None
    if scene.object_mesh is not None:
        write_mesh(folder / MESH_FILE, scene.object_mesh)
        geometry = GeometryFile(MESH_FILE)
    height, width = scene.size
    record = SceneFile(
        version=1,
        name=scene.name,
        width=width,
        height=height,
        background=background,
        object=inserted,
        albedo_scale=scene.albedo_scale,
        field_of_view=scene.field_of_view,
        footprint_depth=footprint,
        truth=truth,
        object_geometry=geometry,
        ground=scene.ground,
    )
    write_json(folder / SCENE_FILE, encode(record))


def _read_geometry(folder: Path, entry: GeometryFile | None) -> ObjectMesh | None:
    if entry is None:
        return None
    pose = None if entry.pose is None else np.array(entry.pose, dtype=np.float64)
    return read_mesh(_inside(folder, entry.file), pose)


def _inside(folder: Path, name: str) -> Path:
    """The path of a file that ``scene.json`` names, which must not leave the bundle."""
    try:
        path = (folder / name).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # a null byte, a symlink to itself
        raise SceneError(f"{folder / SCENE_FILE}: {name!r} is no file: {error}") from error
    if not path.is_relative_to(folder.resolve()):
        raise UnsafePathError(
            f"{folder / SCENE_FILE}: {name!r} lies outside the bundle; "
            "copy the file into the scene's folder and name it there"
        )
    return path


def _maps_of(maps: Intrinsics) -> Iterator[tuple[str, FloatArray]]:
    for name in MAP_NAMES:
        value = getattr(maps, name)
        if value is not None:
            yield name, value


def _file(stem: str) -> str:
    """File of a map: EXR for what is not within [0, 1]."""
    return f"{stem}.exr" if stem.endswith(("depth", "normal")) else f"{stem}.png"


def _write_background(
    folder: Path, name: str, value: FloatArray, working_side: int | None
) -> MapFile:
    if working_side is None or max(value.shape[:2]) <= working_side:
        return write_map(folder, _file(f"background_{name}"), value)
    if name == "albedo":
        return write_reduced(folder, "background_albedo.jpg", value, working_side)
    return write_reduced(folder, _file(f"background_{name}"), value, working_side)


def _copy_photograph(folder: Path, photograph: Path) -> MapFile:
    name = f"background{photograph.suffix.lower()}"
    data = read_bytes(photograph)
    with replacing(folder / name) as unfinished:
        unfinished.write_bytes(data)
    return MapFile(name, encoding="srgb")
