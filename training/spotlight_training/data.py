"""Rendered scenes as training samples.

`pack` turns scene records into one memory-mapped file a split, because decoding a record takes
longer than a training step; `RendererData` and `PictureData` draw samples from it. Every sample is
another lighting: one of the scene's lights (sometimes two) over its ambient light, with random
strength, warmth and exposure, flipped half of the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spotlight_runtime.conditioning import stack_maps
from spotlight_spec import BackboneSpec
from spotlight_training.masks import random_mask

__all__ = ["Packed", "PictureData", "RendererData", "pack"]

FloatArray = npt.NDArray[np.float32]

SIDE = 256
LIGHTS = 4
_MAPS = ("albedo", "normal", "depth", "roughness", "metallic")


def _scene_dtype(side: int, lights: int) -> np.dtype[Any]:
    """One scene, composed: 8 bit where the record has 8 bit, half precision for radiance."""
    plane, colour = (side, side), (side, side, 3)
    return np.dtype(
        [
            ("albedo", np.uint8, colour),
            ("normal", np.uint8, colour),
            ("depth", np.float16, plane),
            ("roughness", np.uint8, plane),
            ("metallic", np.uint8, plane),
            ("object_mask", np.uint8, plane),
            ("ambient", np.float16, colour),
            ("lights", np.float16, (lights, *colour)),
            ("ambient_weight", np.float32),
        ]
    )


def pack(records: Path, out: Path, *, lights: int = LIGHTS, side: int = SIDE) -> int:
    """Write all whole records of a folder into one memory-mapped file.

    Parameters
    ----------
    records : Path
        Folder of ``*.scene.zip``.
    out : Path
        File to write (write-then-rename).
    lights, side : int
        Lights taken from each scene, and its side in pixels.

    Returns
    -------
    int
        Number of scenes packed; records that cannot be read are left out.

    Raises
    ------
    FileNotFoundError
        If there is no record.
    """
    from rich.progress import track

    from spotlight_training.render.record import SUFFIX, SceneRecord

    paths = sorted(records.glob(f"*{SUFFIX}"))
    if not paths:
        raise FileNotFoundError(
            f"{records}: expected rendered scenes (*{SUFFIX}), found none. "
            "Render them with 'spotlight-train render'."
        )
    partial = out.with_name(out.name + ".partial")
    partial.parent.mkdir(parents=True, exist_ok=True)
    count = 0
    with partial.open("wb") as stream:
        for path in track(paths, description="packing"):
            try:
                record = SceneRecord.load(path)
            except (ValueError, KeyError, OSError):
                continue
            stream.write(_packed(record, side, lights).tobytes())
            count += 1
    partial.replace(out)
    return count


def _packed(record: Any, side: int, lights: int) -> npt.NDArray[Any]:
    scene = np.zeros((), dtype=_scene_dtype(side, lights))
    maps = record.composed()
    scene["albedo"] = _eight_bit(maps.albedo)
    scene["normal"] = _eight_bit(0.5 + 0.5 * maps.normal)
    scene["depth"] = maps.depth
    scene["roughness"] = _eight_bit(maps.roughness)
    scene["metallic"] = _eight_bit(maps.metallic)
    scene["object_mask"] = _eight_bit(record.object.alpha)
    scene["ambient"] = np.minimum(record.ambient, 6e4)
    images = list(record.lights.values())[:lights]
    scene["lights"] = np.minimum(np.stack([images[i % len(images)] for i in range(lights)]), 6e4)
    scene["ambient_weight"] = float(np.mean(record.description.ambient.weight))
    return scene


def _eight_bit(values: FloatArray) -> npt.NDArray[np.uint8]:
    return np.round(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)


class Packed:
    """The scenes of a packed file, by index."""

    def __init__(self, path: Path, *, lights: int = LIGHTS, side: int = SIDE) -> None:
        dtype = _scene_dtype(side, lights)
        if not path.is_file() or path.stat().st_size < dtype.itemsize:
            raise FileNotFoundError(
                f"{path}: expected packed scenes, found none; make them with 'spotlight-train pack'"
            )
        self._scenes = np.memmap(path, dtype=dtype, mode="r")

    def __len__(self) -> int:
        return len(self._scenes)

    def __getitem__(self, index: int) -> Any:
        return self._scenes[index]


@dataclass(frozen=True)
class Picture:
    """One lighting of one scene: gamma-2.2 image and maps, float32, (H, W[, C])."""

    image: FloatArray
    maps: dict[str, FloatArray]
    object_mask: FloatArray


def draw_picture(scene: Any, rng: np.random.Generator) -> Picture:
    """Light a packed scene at random, and flip it half of the time."""
    radiance = scene["ambient"].astype(np.float32) * (
        scene["ambient_weight"] * np.exp(rng.normal(0.0, 0.4))
    )
    chosen = rng.permutation(len(scene["lights"]))[: 2 if rng.random() < 0.15 else 1]
    for light in chosen:
        warmth = np.exp(rng.normal(0.0, 0.12) * np.float32([1.0, 0.0, -1.0]))
        strength = np.exp(rng.normal(0.0, 0.3)) * warmth / len(chosen)
        radiance = radiance + scene["lights"][light].astype(np.float32) * strength
    bright = float(np.percentile(radiance.max(axis=2), 95))
    exposure = np.clip(0.9 / max(bright, 1e-6), 0.25, 4.0) * np.exp(rng.normal(0.0, 0.2))
    image = np.clip(radiance * exposure, 0.0, 1.0) ** np.float32(1 / 2.2)
    maps = {
        name: scene[name].astype(np.float32) / np.float32(1.0 if name == "depth" else 255.0)
        for name in _MAPS
    }
    maps["normal"] = np.float32(2.0) * maps["normal"] - np.float32(1.0)
    mask = scene["object_mask"].astype(np.float32) / 255.0
    if rng.random() < 0.5:
        image, mask = image[:, ::-1], mask[:, ::-1]
        maps = {name: value[:, ::-1] for name, value in maps.items()}
        maps["normal"] = maps["normal"] * np.float32([-1.0, 1.0, 1.0])
    return Picture(image.astype(np.float32), maps, mask)


class PictureData:
    """Images in [−1, 1] for the VAE: pictures, and the maps it will have to encode."""

    def __init__(self, packed: Packed) -> None:
        self._packed = packed

    def __call__(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Draw one sample: ``image`` of shape (3, H, W)."""
        picture = draw_picture(self._packed[int(rng.integers(len(self._packed)))], rng)
        kind = rng.random()
        if kind < 0.7:
            return {"image": _chw(2.0 * picture.image - 1.0)}
        if kind < 0.85:
            return {"image": _chw(2.0 * picture.maps["albedo"] - 1.0)}
        return {"image": _chw(picture.maps["normal"])}


class RendererData:
    """Pictures with the conditioning the renderer gets: maps, and shading hidden in places."""

    def __init__(self, packed: Packed, spec: BackboneSpec) -> None:
        self._packed, self._spec = packed, spec

    def __call__(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Draw one sample: ``image`` (3, H, W) and ``conditioning`` (K, H, W)."""
        picture = draw_picture(self._packed[int(rng.integers(len(self._packed)))], rng)
        hidden = random_mask(rng, picture.object_mask)
        return {
            "image": _chw(2.0 * picture.image - 1.0),
            "conditioning": stack_maps(
                self._spec, picture.maps, picture.image, picture.maps["albedo"], hidden
            ),
        }


class IntrinsicsData:
    """Pictures and their maps, for the estimator."""

    def __init__(self, packed: Packed) -> None:
        self._packed = packed

    def __call__(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Draw one sample: ``image`` in [0, 1], ``albedo``, ``normal`` in [−1, 1], ``depth``."""
        picture = draw_picture(self._packed[int(rng.integers(len(self._packed)))], rng)
        return {
            "image": _chw(picture.image),
            "albedo": _chw(picture.maps["albedo"]),
            "normal": _chw(picture.maps["normal"]),
            "depth": picture.maps["depth"][None].astype(np.float32),
        }


def _chw(pixels: npt.NDArray[Any]) -> FloatArray:
    return np.ascontiguousarray(pixels.transpose(2, 0, 1), dtype=np.float32)
