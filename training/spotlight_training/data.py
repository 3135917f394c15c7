"""Rendered scenes packed for training, and the samples drawn from them.

`pack` turns scene records into one memory-mapped file a split, because decoding a record takes
longer than a training step; `draw_picture` lights, crops and flips a packed scene at random, and
`PictureData`, `RendererData` and `IntrinsicsData` make samples of that.

Every picture is another lighting: one of the scene's lights (sometimes two) over its ambient
light, with random strength, warmth and exposure. Where one light alone lit everything, the
background's shading would tell the renderer where it is, and the object's own shadow would tell it
nothing new. So some pictures are composites, as SpotLight's results are: the object and its shadow
under one light, laid over the background under another by the ratio of the background with and
without the object. What then agrees with the object's shading is its shadow.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.diffusion.conditioning import stack_maps
from spotlight_spec import BackboneSpec, replacing
from spotlight_training.masks import random_mask

__all__ = [
    "IntrinsicsData",
    "Packed",
    "Picture",
    "PictureData",
    "RendererData",
    "draw_picture",
    "pack",
]

FloatArray = npt.NDArray[np.float32]

SIDE: Final = 256
LIGHTS: Final = 6
COMPOSITES: Final = 0.7
"""Share of pictures whose background is lit by another light than the object."""
TWO_LIGHTS: Final = 0.15
SMALLEST_CROP: Final = 0.6
"""Of the scene's side; objects fill a third to a half of it."""
_UNIT_MAPS = ("albedo", "normal", "roughness", "metallic")


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
            ("ambient_background", np.float16, colour),
            ("lights", np.float16, (lights, *colour)),
            ("lights_background", np.float16, (lights, *colour)),
            ("ambient_weight", np.float32),
            ("towards", np.float32, (lights, 3)),
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
    ValueError
        If a record is of another side.
    """
    from rich.progress import track

    from spotlight_training.render.record import SUFFIX, SceneRecord

    paths = sorted(records.glob(f"*{SUFFIX}"))
    if not paths:
        raise FileNotFoundError(
            f"{records}: expected rendered scenes (*{SUFFIX}), found none. "
            "Render them with 'spotlight-train render'."
        )
    out.parent.mkdir(parents=True, exist_ok=True)
    count = 0
    with replacing(out) as partial, partial.open("wb") as stream:
        for path in track(paths, description="packing"):
            try:
                record = SceneRecord.load(path)
            except (ValueError, KeyError, OSError):
                continue
            found = record.object.alpha.shape[0]
            if found != side:
                raise ValueError(
                    f"{path}: expected a scene of {side}×{side} pixels, found {found}×{found}; "
                    f"render it with --size {side}"
                )
            stream.write(_packed(record, side, lights).tobytes())
            count += 1
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
    scene["ambient"] = record.ambient
    scene["ambient_background"] = record.ambient_background
    for name, images in (
        ("lights", list(record.lights.values())),
        ("lights_background", list(record.lights_background.values())),
    ):
        scene[name] = np.stack([images[i % len(images)] for i in range(lights)])
    scene["ambient_weight"] = float(np.mean(record.description.ambient.weight))
    lamps = {lamp.name: lamp for lamp in record.description.lights}
    towards = [_seen_towards(lamps[name], record.description.camera) for name in record.lights]
    scene["towards"] = [towards[i % len(towards)] for i in range(lights)]
    return scene


def _seen_towards(lamp: Any, camera: Any) -> FloatArray:
    """Unit vector from the object to a light, in the normals' frame: right, up, to the camera."""
    azimuth, elevation, pitch = np.deg2rad([lamp.azimuth, lamp.elevation, camera.pitch])
    right, forward = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    above = np.sin(elevation)
    return np.array(
        [
            right,
            np.cos(pitch) * above + np.sin(pitch) * forward,
            np.sin(pitch) * above - np.cos(pitch) * forward,
        ],
        np.float32,
    )


def _eight_bit(values: FloatArray) -> npt.NDArray[np.uint8]:
    return np.round(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)


class Packed:
    """The scenes of a packed file, by index."""

    def __init__(self, path: Path, *, lights: int = LIGHTS, side: int = SIDE) -> None:
        dtype = _scene_dtype(side, lights)
        size = path.stat().st_size if path.is_file() else 0
        if size < dtype.itemsize or size % dtype.itemsize:
            raise FileNotFoundError(
                f"{path}: expected packed scenes of {side}×{side} pixels and {lights} lights, "
                "found none; make them with 'spotlight-train pack'"
            )
        self._scenes = np.memmap(path, dtype=dtype, mode="r")

    def __len__(self) -> int:
        return len(self._scenes)

    def __getitem__(self, index: int) -> Any:
        return self._scenes[index]

    def draw(self, rng: np.random.Generator, side: int, smallest: float = SMALLEST_CROP) -> Picture:
        """Draw a picture of any of the scenes; see `draw_picture`."""
        return draw_picture(self[int(rng.integers(len(self)))], rng, side, smallest)


@dataclass(frozen=True)
class Picture:
    """One lighting of one scene: gamma-2.2 image and maps, float32, (side, side[, C]).

    ``shadow`` is what the object takes of the background's light, 0 to 1; ``lamps`` (2, 4) are
    directions to the lights, in the normals' frame, and each one's share of their light.
    """

    image: FloatArray
    maps: dict[str, FloatArray]
    object_mask: FloatArray
    shadow: FloatArray
    lamps: FloatArray


def draw_picture(
    scene: Any, rng: np.random.Generator, side: int = SIDE, smallest: float = SMALLEST_CROP
) -> Picture:
    """Crop, light and flip a packed scene at random.

    Parameters
    ----------
    scene : numpy.void
        A row of `Packed`.
    rng : numpy.random.Generator
    side : int
        Of the picture; crops are never enlarged.
    smallest : float
        Smallest crop, as a share of the scene's side.
    """
    full = scene["object_mask"].shape[0]
    size = int(rng.integers(max(side, int(smallest * full)), full + 1))
    window = _crop(scene["object_mask"], rng, size)

    def cut(name: str, *index: int) -> FloatArray:
        pixels = scene[name][(*index, *window)].astype(np.float32)
        if pixels.shape[0] != side:
            pixels = cv2.resize(pixels, (side, side), interpolation=cv2.INTER_AREA)
        return pixels

    maps = {name: cut(name) / np.float32(255.0) for name in _UNIT_MAPS}
    normal = np.float32(2.0) * maps["normal"] - np.float32(1.0)
    maps["normal"] = normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-3)
    maps["depth"] = cut("depth")
    mask = cut("object_mask") / np.float32(255.0)
    radiance, shadow, lamps = _light(scene, rng, cut, mask)
    bright = float(np.percentile(np.maximum.reduce(_channels(radiance[::4, ::4])), 95))
    exposure = np.clip(0.9 / max(bright, 1e-6), 0.25, 4.0) * np.exp(rng.normal(0.0, 0.2))
    image = np.clip(radiance * np.float32(exposure), 0.0, 1.0) ** np.float32(1 / 2.2)
    # Light is transported channel by channel, so any order of the channels is a true picture too.
    order = rng.permutation(3)
    image, maps["albedo"] = image[..., order], maps["albedo"][..., order]
    if rng.random() < 0.5:
        image, mask, shadow = image[:, ::-1], mask[:, ::-1], shadow[:, ::-1]
        maps = {name: value[:, ::-1] for name, value in maps.items()}
        maps["normal"] = maps["normal"] * np.float32([-1.0, 1.0, 1.0])
        lamps = lamps * np.float32([-1.0, 1.0, 1.0, 1.0])
    image, mask, shadow = (np.ascontiguousarray(plane) for plane in (image, mask, shadow))
    return Picture(image, maps, mask, shadow, lamps)


def _crop(mask: npt.NDArray[np.uint8], rng: np.random.Generator, size: int) -> tuple[slice, slice]:
    """A square window; it holds the object's box where that fits."""
    full = mask.shape[0]
    window = []
    for axis in (1, 0):
        covered = np.flatnonzero(mask.max(axis=axis))
        low, high = (covered[0], covered[-1] + 1) if covered.size else (0, 0)
        first, last = max(0, high - size), min(low, full - size)
        if first > last:
            first, last = 0, full - size
        start = int(rng.integers(first, last + 1))
        window.append(slice(start, start + size))
    return window[0], window[1]


def _light(
    scene: Any, rng: np.random.Generator, cut: Any, mask: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Linear radiance of the crop under a random lighting, the object's shadow, and the lamps."""
    order = rng.permutation(len(scene["lights"]))
    count = 2 if rng.random() < TWO_LIGHTS else 1
    ambient = float(scene["ambient_weight"]) * np.exp(rng.normal(0.0, 0.4))

    def strengths() -> FloatArray:
        warmth = np.exp(rng.normal(0.0, 0.12, (count, 1)) * np.float32([1.0, 0.0, -1.0]))
        return (np.exp(rng.normal(0.0, 0.3, (count, 1))) * warmth / count).astype(np.float32)

    def lit(suffix: str, lights: npt.NDArray[np.int64], weights: FloatArray) -> FloatArray:
        total = np.float32(ambient) * cut(f"ambient{suffix}")
        for light, weight in zip(lights, weights):
            total = total + weight * cut(f"lights{suffix}", int(light))
        return total

    chosen, weights = order[:count], strengths()
    radiance = lit("", chosen, weights)
    alone = lit("_background", chosen, weights)
    ratio = np.clip((sum(_channels(radiance)) + 3e-4) / (sum(_channels(alone)) + 3e-4), 0.0, 1.0)
    shadow = (1 - mask) * (1 - ratio)
    lamps = np.zeros((2, 4), np.float32)
    lamps[:count, :3] = scene["towards"][chosen]
    lamps[:count, 3] = weights.mean(axis=1) / weights.mean(axis=1).sum()
    if rng.random() >= COMPOSITES:
        return radiance, shadow, lamps
    background = lit("_background", order[-count:], strengths())
    cover = mask[..., None]
    return cover * radiance + (1 - cover) * background * ratio[..., None], shadow, lamps


def _channels(image: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Red, green and blue apart: NumPy reduces over a last axis of three slowly."""
    return image[..., 0], image[..., 1], image[..., 2]


class PictureData:
    """Images in [−1, 1] for the VAE: pictures, and the albedo it will have to encode.

    Half of the crops keep the scene's own pixels, for detail; the others are shrunk.
    """

    def __init__(self, packed: Packed, side: int = SIDE) -> None:
        self._packed, self._side = packed, side

    def __call__(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Draw one sample: ``image`` of shape (3, side, side)."""
        side = self._side
        picture = self._packed.draw(rng, side, 0.0 if rng.random() < 0.5 else SMALLEST_CROP)
        pixels = picture.image if rng.random() < 0.8 else picture.maps["albedo"]
        return {"image": _chw(2.0 * pixels - 1.0)}


class RendererData:
    """Pictures with the conditioning the renderer gets: maps, and shading hidden in places."""

    def __init__(self, packed: Packed, spec: BackboneSpec, side: int = SIDE) -> None:
        self._packed, self._spec, self._side = packed, spec, side

    def __call__(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Draw one sample: ``image``, ``conditioning``, and what teaches to find the light.

        Shapes are (3, side, side), (K, side, side), and (1, side, side) of ``object_mask`` and
        ``shadow``; ``lamps`` as `Picture` has them.
        """
        picture = self._packed.draw(rng, self._side)
        hidden = random_mask(rng, picture.object_mask)
        return {
            "image": _chw(2.0 * picture.image - 1.0),
            "conditioning": stack_maps(
                self._spec, picture.maps, picture.image, picture.maps["albedo"], hidden
            ),
            "object_mask": picture.object_mask[None],
            "shadow": picture.shadow[None].astype(np.float32),
            "lamps": picture.lamps,
        }


class IntrinsicsData:
    """Pictures and their maps, for the estimator."""

    def __init__(self, packed: Packed, side: int = SIDE) -> None:
        self._packed, self._side = packed, side

    def __call__(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Draw one sample: ``image`` in [0, 1], ``albedo``, ``normal`` in [−1, 1], ``depth``."""
        picture = self._packed.draw(rng, self._side)
        return {
            "image": _chw(picture.image),
            "albedo": _chw(picture.maps["albedo"]),
            "normal": _chw(picture.maps["normal"]),
            "depth": np.ascontiguousarray(picture.maps["depth"][None], dtype=np.float32),
        }


def _chw(pixels: npt.NDArray[Any]) -> FloatArray:
    return np.ascontiguousarray(pixels.transpose(2, 0, 1), dtype=np.float32)
