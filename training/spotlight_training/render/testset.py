"""Exports records to the layout of the published SpotLight test set: one folder a scene.

`<name>_bundle0001.exr` holds the layers albedo, background, composite, depth, footprint_depth,
foreground, metallic, normals and roughness (premultiplied RGBA; scalar layers carry their value in
B) and mask.R. Beside it lie the background's maps (`<name>_bg_depth.exr`, `_bg_normal.png`,
`_bg_diffuse.png`, `_bg_roughness.png`, `_bg_metallic.png`), the guiding shadows
`shadow_positive_*.png` and `shadow_negative_*.png`, and `meta.json`.

The layer composite is the truth of the photograph's own dominant light. For every other direction
there is, beyond the published layout, `truth_*.exr`: linear RGB of the same photograph with the
object lit from there (see `truth.relit_truth`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from . import codec, exr
from .description import SceneDescription
from .mesh import Array
from .record import SUFFIX, SceneRecord
from .scenes import OPPOSITE
from .truth import relit_truth

OPPOSITE_TOLERANCE = 1.0
"""Degrees within which a rendered light counts as the opposite of another."""


def export_folder(records: Path, output: Path, light: str = "gt_dir") -> Iterator[Path]:
    """Export every record below a folder and yield each scene's folder.

    Raises
    ------
    FileNotFoundError
        If there is no record.
    """
    paths = sorted(records.rglob(f"*{SUFFIX}"))
    if not paths:
        raise FileNotFoundError(
            f"records: expected *{SUFFIX} files in {records}, found none. "
            "Render them with 'spotlight-train render --evaluation'."
        )
    for path in paths:
        record = SceneRecord.load(path)
        name = f"{record.description.split}_{record.description.seed:06d}"
        yield export_scene(record, name, output / name, light)


def export_scene(record: SceneRecord, name: str, folder: Path, light: str = "gt_dir") -> Path:
    """Export one record and return its folder.

    Parameters
    ----------
    record : SceneRecord
    name : str
        Scene name that the files begin with.
    folder : Path
        Made if missing.
    light : str
        Dominant light of the truth; the ambient light joins it at the scene's own weight, and the
        exposure that suits the background is applied to all pictures.

    Raises
    ------
    KeyError
        If the scene has no such light.
    """
    if light not in record.lights:
        raise KeyError(
            f"light: the scene {name} has the lights {', '.join(sorted(record.lights))}; "
            f"got {light!r}. Render with --evaluation, "
            "or name another with --light."
        )
    folder.mkdir(parents=True, exist_ok=True)
    weights = {light: 1.0}
    exposure = record.exposure(weights)
    background = record.radiance(weights, with_object=False) * exposure
    composite = record.radiance(weights) * exposure
    exr.write(folder / f"{name}_bundle0001.exr", _bundle(record, background, composite))
    back = record.background
    exr.write(
        folder / f"{name}_bg_depth.exr",
        {channel: back.depth.astype(np.float32) for channel in "RGB"},
    )
    _png(folder / f"{name}_bg_normal.png", back.normal * 0.5 + 0.5)
    _png(folder / f"{name}_bg_diffuse.png", back.albedo)
    _png(folder / f"{name}_bg_roughness.png", back.roughness)
    _png(folder / f"{name}_bg_metallic.png", back.metallic)
    outside = 1.0 - record.object.alpha
    for own, shadow in record.shadows.items():
        if own == OPPOSITE:
            continue
        _png(folder / f"shadow_positive_{own}.png", shadow * outside)
        other = _opposite(record.description, own)
        if other is not None:
            _png(folder / f"shadow_negative_{own}.png", record.shadows[other] * outside)
        if own != light:
            truth = relit_truth(record, own, background, exposure).astype(np.float16)
            exr.write(
                folder / f"truth_{own}.exr",
                {channel: truth[..., i] for i, channel in enumerate("RGB")},
            )
    meta = json.dumps(_meta(record.description, light, exposure), indent=1)
    (folder / "meta.json").write_text(meta + "\n", encoding="utf-8")
    return folder


def _bundle(record: SceneRecord, background: Array, composite: Array) -> dict[str, Array]:
    front = record.object
    alpha = front.alpha
    touch = (record.footprint_depth > 0).astype(np.float32)
    layers: dict[str, tuple[Array, Array]] = {
        "albedo": (front.albedo * alpha[..., None], alpha),
        "background": (background, np.ones_like(alpha)),
        "composite": (composite, np.ones_like(alpha)),
        "depth": (_in_blue(front.depth * alpha), alpha),
        "footprint_depth": (_in_blue(record.footprint_depth), touch),
        "foreground": (composite * alpha[..., None], alpha),
        "metallic": (_in_blue(front.metallic * alpha), alpha),
        "normals": (front.normal * alpha[..., None], alpha),
        "roughness": (_in_blue(front.roughness * alpha), alpha),
    }
    channels = {"mask.R": alpha}
    for layer, (colour, coverage) in layers.items():
        channels |= {f"{layer}.{channel}": colour[..., i] for i, channel in enumerate("RGB")}
        channels[f"{layer}.A"] = coverage
    # Half floats step by a centimetre at ten metres, which is too coarse for depth alone.
    return {
        name: plane.astype(np.float32 if "depth" in name else np.float16)
        for name, plane in channels.items()
    }


def _opposite(scene: SceneDescription, name: str) -> str | None:
    """Return the light across the object at the same elevation, if the scene has it."""
    angles = {light.name: (light.azimuth, light.elevation) for light in scene.lights}
    azimuth, elevation = angles[name]
    for other, (a, e) in angles.items():
        apart = abs((a - azimuth + 180.0) % 360.0 - 180.0)
        if abs(apart - 180.0) <= OPPOSITE_TOLERANCE and abs(e - elevation) <= OPPOSITE_TOLERANCE:
            return other
    return None


def _meta(scene: SceneDescription, light: str, exposure: float) -> dict[str, Any]:
    x, y, z = scene.camera.position
    lights: Mapping[str, Any] = {
        one.name: {
            "azimuth": one.azimuth,
            "elevation": one.elevation,
            "distance": one.distance,
            "radius": one.radius,
        }
        for one in scene.lights
        if one.name != OPPOSITE
    }
    return {
        "maps": "rendered",
        "seed": scene.seed,
        "split": scene.split,
        "fov": scene.camera.fov,
        "truth_light": light,
        "exposure": exposure,
        "ambient": {
            "kind": scene.ambient.kind,
            "name": scene.ambient.name,
            "weight": scene.ambient.weight,
        },
        "lights": lights,
        "azimuth_frame": "degrees in the floor plane, 0 = camera right, 90 = away from the camera",
        "camera": {"height": z, "pitch": scene.camera.pitch, "distance": float(np.hypot(x, y))},
        "object": {
            "kind": scene.subject.kind,
            "size": scene.subject.size,
            "position": [0.0, 0.0, scene.support_height],
        },
    }


def _in_blue(plane: Array) -> Array:
    return np.stack([np.zeros_like(plane), np.zeros_like(plane), plane], axis=2)


def _png(path: Path, values: Array) -> None:
    path.write_bytes(codec.to_png(codec.encode_unit(values)))
