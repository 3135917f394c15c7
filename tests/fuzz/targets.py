"""The parsers, each as a function of the bytes of one file in a folder that is otherwise whole."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from support.scenes import make_scene

from fuzz import seeds
from spotlight_runtime import Scene, read_image, write_image
from spotlight_runtime.composing.cutout import read_cutout
from spotlight_runtime.composing.photograph import read_photograph
from spotlight_runtime.composing.product_files import load_product
from spotlight_runtime.errors import SpotLightError
from spotlight_runtime.geometry.mesh_files import read_mesh
from spotlight_runtime.imaging.headers import read_header
from spotlight_runtime.imaging.images import read_exr_layers
from spotlight_runtime.networks.models import open_networks, resolve_model
from spotlight_runtime.relighting.lights_file import read_lights
from spotlight_runtime.relighting.shadow_files import read_drawing
from spotlight_runtime.scenes.testset import load_published
from spotlight_spec import RecordError

__all__ = ["REFUSALS", "TARGETS", "Target"]

REFUSALS = (SpotLightError, RecordError)
"""What a parser may raise."""

Run = Callable[[bytes], object]


@dataclass(frozen=True)
class Target:
    """A parser.

    Attributes
    ----------
    name : str
    shape : {"json", "glb", "zip", "image", "text", "bytes"}
        What the mutators may know of the format.
    make : callable
        ``make(folder) -> (run, seeds)``: prepares the folder; ``run(data)`` parses.
    """

    name: str
    shape: str
    make: Callable[[Path], tuple[Run, Iterable[bytes]]]


def _scene(folder: Path) -> tuple[Run, Iterable[bytes]]:
    import trimesh.exchange.load  # noqa: F401 - its first import takes seconds of its own

    bundle = seeds.write_scene(folder / "scene")
    starts = list(seeds.scenes(bundle))

    def run(data: bytes) -> object:
        (bundle / "scene.json").write_bytes(data)
        return Scene.load(bundle)

    return run, starts


def _zip(folder: Path) -> tuple[Run, Iterable[bytes]]:
    starts = list(seeds.zipped(seeds.write_scene(folder / "scene")))

    def run(data: bytes) -> object:
        (folder / "a.zip").write_bytes(data)
        return Scene.load(folder / "a.zip")

    return run, starts


def _image(folder: Path) -> tuple[Run, Iterable[bytes]]:
    """All that is done with a picture: read as a map, a photograph, a cut-out, a drawing."""
    mask = make_scene(*seeds.SIZE).object_mask

    def run(data: bytes) -> object:
        read_header(data)
        suffix = ".exr" if data.startswith(b"\x76\x2f\x31\x01") else _suffix(data)
        path = folder / f"picture{suffix}"
        path.write_bytes(data)
        for use in (read_image, read_photograph, read_cutout):
            _allowed(use, path)
        return read_drawing(path, mask)

    return run, list(seeds.images(folder))


def _suffix(data: bytes) -> str:
    known = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"RIFF": ".webp", b"#?": ".hdr"}
    return next((suffix for start, suffix in known.items() if data.startswith(start)), ".png")


def _exr(folder: Path) -> tuple[Run, Iterable[bytes]]:
    seeds.published(folder)
    starts = list(seeds.exr_files(seeds.fresh(folder / "made")))

    def run(data: bytes) -> object:
        path = folder / "ball_bundle0001.exr"
        path.write_bytes(data)
        _allowed(lambda _: load_published(folder), path)
        _allowed(read_image, path)
        return read_exr_layers(path)

    return run, starts


def _gltf(folder: Path) -> tuple[Run, Iterable[bytes]]:
    starts = list(seeds.gltf_files(folder))

    def run(data: bytes) -> object:
        (folder / "a.glb").write_bytes(data)
        _allowed(lambda path: load_product(path, "red"), folder / "a.glb")
        return load_product(folder / "a.glb")

    return run, starts


def _obj(folder: Path) -> tuple[Run, Iterable[bytes]]:
    import trimesh.exchange.load  # noqa: F401 - as above

    starts = list(seeds.obj_files(folder))

    def run(data: bytes) -> object:
        model, _, material = data.partition(b"%\n")
        (folder / "a.obj").write_bytes(model)
        (folder / "m.mtl").write_bytes(material)
        return load_product(folder / "a.obj")

    return run, starts


def _mesh(folder: Path) -> tuple[Run, Iterable[bytes]]:
    starts = list(seeds.mesh_files(folder))
    known = {b"PK": ".npz", b"ply": ".ply", b"glTF": ".glb", b"solid": ".stl", b"\0": ".stl"}

    def run(data: bytes) -> object:
        suffix = next((s for start, s in known.items() if data.startswith(start)), ".obj")
        path = folder / f"mesh{suffix}"
        path.write_bytes(data)
        return read_mesh(path)

    return run, starts


def _manifest(folder: Path) -> tuple[Run, Iterable[bytes]]:
    starts = list(seeds.manifests(folder / "tiny"))

    def run(data: bytes) -> object:
        (folder / "tiny/manifest.json").write_bytes(data)
        return open_networks(resolve_model(folder / "tiny"))

    return run, starts


def _lights(folder: Path) -> tuple[Run, Iterable[bytes]]:
    mask = make_scene(*seeds.SIZE).object_mask
    write_image(folder / "lamp.png", mask)

    def run(data: bytes) -> object:
        (folder / "lights.json").write_bytes(data)
        return read_lights(folder / "lights.json", mask)

    return run, list(seeds.lights())


def _allowed(use: Callable[[Path], object], path: Path) -> None:
    """One more use of a file, which may refuse it for reasons of its own."""
    with contextlib.suppress(*REFUSALS):
        use(path)


TARGETS = {
    target.name: target
    for target in (
        Target("scene", "json", _scene),
        Target("zip", "zip", _zip),
        Target("image", "image", _image),
        Target("exr", "bytes", _exr),
        Target("gltf", "glb", _gltf),
        Target("obj", "text", _obj),
        Target("mesh", "bytes", _mesh),
        Target("manifest", "json", _manifest),
        Target("lights", "json", _lights),
    )
}
