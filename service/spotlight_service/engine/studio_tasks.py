"""What the studio does: makes scenes of uploads, sketches lights, converts pictures.

Each task takes paths and plain values, and returns plain values or a picture's bytes.
"""

from __future__ import annotations

import base64
import hashlib
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from spotlight_runtime import Scene, read_image
from spotlight_runtime.cli.demo import SCENES
from spotlight_runtime.composing.compose import draft
from spotlight_runtime.errors import ShadowWarning, SpotLightError
from spotlight_runtime.imaging.colour import linear_to_srgb
from spotlight_runtime.imaging.images import encode_png, write_image
from spotlight_runtime.imaging.picture_files import write_picture
from spotlight_runtime.relighting.casting import caster_of, megapixel
from spotlight_runtime.relighting.guides import Guide
from spotlight_runtime.relighting.preview import preview
from spotlight_runtime.relighting.window import Window, look
from spotlight_runtime.shadows.shadow import floor_of
from spotlight_service.engine.composing import compose_upload
from spotlight_service.engine.scene_cache import SceneCache
from spotlight_service.engine.uploads import bundle_digest, check_bundle, unpack_bundle
from spotlight_service.lighting import guides_of
from spotlight_service.problems import FieldError
from spotlight_service.storage.scene_info import SceneInfo
from spotlight_spec import encode

__all__ = ["TASKS", "Studio", "samples"]

Answer = tuple[dict[str, Any], bytes]
DRAFT_FILE: Final = "preview.png"
QUALITY: Final = 92


def samples() -> list[str]:
    """Names of the scenes that come along."""
    return sorted(path.name for path in SCENES.iterdir() if path.is_dir())


class Studio:
    """The studio's tasks and the scenes it holds.

    Parameters
    ----------
    cache_bytes : int
        Of loaded scenes.
    most_pixels, most_bytes, most_files : int
        Limits of uploads; see `Settings`.
    """

    def __init__(
        self, cache_bytes: int, most_pixels: int, most_bytes: int, most_files: int
    ) -> None:
        self._cache = SceneCache(cache_bytes)
        self._pixels, self._bytes, self._files = most_pixels, most_bytes, most_files

    def bundle(self, upload: str, draft_folder: str) -> Answer:
        """Make a scene of a zipped bundle; says where it lies."""
        unpacked = Path(draft_folder) / "unpacked"
        unpacked.mkdir()
        limits = {"most_bytes": self._bytes, "most_files": self._files}
        made = unpack_bundle(Path(upload), unpacked, **limits)
        check_bundle(made, self._pixels, self._bytes)
        return self._stored(made, bundle_digest(made), "a bundle")

    def sample(self, name: str, draft_folder: str) -> Answer:
        """Make a scene of one that comes along."""
        if name not in samples():
            raise FieldError("sample", f"one of {', '.join(samples())}", name)
        made = Path(draft_folder) / "scene"
        made.mkdir()
        for source in (SCENES / name).iterdir():
            (made / source.name).write_bytes(source.read_bytes())
        return self._stored(made, bundle_digest(made), f"the sample {name}")

    def compose(self, parts: dict[str, str], fields: dict[str, Any], draft_folder: str) -> Answer:
        """Make a scene of a photograph and an object; ``parts`` are paths of uploads."""
        made = Path(draft_folder) / "scene"
        digest = hashlib.sha256(json.dumps(fields, sort_keys=True).encode())
        for name, path in sorted(parts.items()):
            content = hashlib.sha256(Path(path).read_bytes()).digest()
            digest.update(name.encode() + b"\0" + content)
        summary = compose_upload({k: Path(v) for k, v in parts.items()}, fields, made, self._pixels)
        return self._stored(made, digest.hexdigest(), summary)

    def check_drawings(self, scene: str, folder: str, lights: list[Any], drawings: str) -> Answer:
        """Read drawn shadows as a relight would."""
        self._drawn(self._scene(scene, folder), lights, Path(drawings))
        return {}, b""

    def sketch(
        self, scene: str, folder: str, lights: list[Any], show: str, side: int, scratch: str
    ) -> Answer:
        """Sketch lights (drawings in base64), or show their guiding shadow; PNG."""
        small = self._small(scene, folder, side)
        for number, light in enumerate(lights):
            for kind in ("shadow", "negative"):
                if light.get(kind) is not None:
                    drawing = Path(scratch) / f"{kind}-{number}.png"
                    drawing.write_bytes(base64.b64decode(light[kind]))
        guides = self._drawn(small, lights, Path(scratch))
        notices: list[str] = []
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ShadowWarning)
            made = preview(small, guides)
            notices += [str(w.message) for w in caught if issubclass(w.category, ShadowWarning)]
        if show == "shadow":
            dark = np.stack([guide.positive for guide in made.guides]).max(axis=0)
            return {"notices": notices}, encode_png(dark)
        return {"notices": notices}, encode_png(made.image)

    def picture(self, scene: str, folder: str, show: str) -> Answer:
        """A scene's draft, its photograph, or the object's mask; PNG."""
        if show == "draft":
            return {}, (Path(folder) / DRAFT_FILE).read_bytes()
        loaded = self._scene(scene, folder)
        if show == "mask":
            return {}, encode_png(loaded.object_mask)
        return {}, encode_png(linear_to_srgb(loaded.background))

    def convert(self, picture: str, pixels: str, suffix: str, scratch: str) -> Answer:
        """A result in another format; EXR is linear, the others as the PNG."""
        target = Path(scratch) / f"result{suffix}"
        exact = suffix == ".exr"  # the others hold no more than the PNG
        encoded = np.load(pixels, allow_pickle=False) if exact else read_image(picture)
        write_picture(target, encoded, quality=QUALITY)
        return {}, target.read_bytes()

    def _stored(self, made: Path, digest: str, summary: str) -> Answer:
        """Load a scene that was just made, to know that it is one, and tell about it."""
        scene = Scene.load(made)
        if scene.size[0] * scene.size[1] > self._pixels:
            got = f"{scene.size[1]}×{scene.size[0]}"
            raise FieldError("scene", f"at most {self._pixels} pixels", got, status=413)
        if not (made / DRAFT_FILE).is_file():
            write_image(made / DRAFT_FILE, draft(scene))
        info = _info(scene, digest, summary)
        self._cache.get(digest, lambda: scene)
        return {"info": encode(info), "folder": str(made)}, b""

    def _scene(self, scene: str, folder: str) -> Scene:
        return self._cache.load(scene, Path(folder))

    def _small(self, scene: str, folder: str, side: int) -> Scene:
        """The scene at a sketch's size, geometry included."""

        def load() -> Scene:
            whole = megapixel(self._scene(scene, folder))
            height, width = whole.size
            factor = min(1.0, side / max(height, width))
            size = max(1, round(height * factor)), max(1, round(width * factor))
            if size == (height, width):
                return whole
            small = look(whole, Window(0, 0, height, width, size, whole.size))
            kept = (whole.field_of_view, whole.object_mesh, whole.ground)
            return replace(small, field_of_view=kept[0], object_mesh=kept[1], ground=kept[2])

        return self._cache.get(f"{scene}@{side}", load)

    @staticmethod
    def _drawn(scene: Scene, lights: list[Any], drawings: Path) -> list[Guide]:
        return guides_of(lights, scene, lambda n, kind: drawings / f"{kind}-{n}.png")


def _info(scene: Scene, digest: str, summary: str) -> SceneInfo:
    height, width = scene.size
    rows, columns = (np.flatnonzero((scene.object_mask > 0.0).any(axis=a)) for a in (1, 0))
    box = (0.0, 0.0, 1.0, 1.0)
    if rows.size:
        left, right = columns[0] / width, (columns[-1] + 1) / width
        box = (left, rows[0] / height, right, (rows[-1] + 1) / height)
    try:
        caster_of(scene)
        casts = True
    except SpotLightError:
        casts = False
    floor = floor_of(megapixel(scene))
    return SceneInfo(
        id=digest,
        name=scene.name,
        width=width,
        height=height,
        field_of_view=scene.camera.field_of_view,
        object_box=tuple(round(float(value), 6) for value in box),  # type: ignore[arg-type]
        coverage=float(scene.object_mask.mean()),
        floor_normal=None if floor is None else tuple(float(v) for v in floor.normal),  # type: ignore[arg-type]
        casts=casts,
        summary=summary,
    )


TASKS: Final = ("bundle", "sample", "compose", "check_drawings", "sketch", "picture", "convert")
