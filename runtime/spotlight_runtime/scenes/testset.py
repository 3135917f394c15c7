"""The published SpotLight/ZeroComp test-set layout, read as a `Scene`.

One folder a scene: ``<name>_bundle0001.exr`` with layers ``albedo depth normals roughness metallic
mask footprint_depth background composite`` (premultiplied RGBA; scalar maps carry value and alpha
in their last two channels), and beside it the background's estimates ``<name>_bg_depth.exr``,
``_bg_normal.png``, ``_bg_diffuse.png`` and, for some, ``_bg_roughness.png`` and
``_bg_metallic.png``. The scale of an estimated albedo is unknown; where a set was rendered, and its
maps are no estimates, ``meta.json`` says ``"maps": "rendered"``.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import SceneError
from spotlight_runtime.imaging.images import read_exr_layers, read_image
from spotlight_runtime.scenes.scene import Intrinsics, Scene
from spotlight_spec import RecordError, read_json

__all__ = ["bundle_file", "load_published"]


META_FILE: Final = "meta.json"
_BUNDLE: Final = "_bundle0001.exr"
_REQUIRED: Final = ("background", "albedo", "mask")


def bundle_file(folder: Path) -> Path | None:
    """Return the ``*_bundle0001.exr`` of a published scene folder, or None."""
    found = sorted(folder.glob(f"*{_BUNDLE}")) if os.path.isdir(folder) else []
    return found[0] if found else None


def load_published(folder: Path, estimates: Path | None = None) -> Scene:
    """Read a scene of the published test set.

    Parameters
    ----------
    folder : Path
        The scene's folder.
    estimates : Path, optional
        Folder of the background's estimated maps; the scene's own folder by default.

    Returns
    -------
    Scene
        Background and truth are the linear ``background`` and ``composite`` layers.

    Raises
    ------
    SceneError
        If the bundle or a required layer or estimate is missing.
    """
    bundle = bundle_file(folder)
    if bundle is None:
        raise SceneError(f"{folder}: expected <name>{_BUNDLE}, found none")
    name = bundle.name.removesuffix(_BUNDLE)
    layers = read_exr_layers(bundle)
    missing = [layer for layer in _REQUIRED if layer not in layers]
    if missing:
        raise SceneError(
            f"{bundle}: expected layers {', '.join(_REQUIRED)}, missing {', '.join(missing)}"
        )
    estimates = estimates or folder
    diffuse = estimates / f"{name}_bg_diffuse.png"
    if not diffuse.is_file():
        raise SceneError(f"{diffuse}: expected the background's estimated albedo, found no file")

    def estimate(map_name: str, suffix: str) -> FloatArray | None:
        path = estimates / f"{name}_bg_{map_name}.{suffix}"
        return read_image(path) if path.is_file() else None

    normal = estimate("normal", "png")
    return Scene(
        background=_colour(layers["background"]),
        background_maps=Intrinsics(
            albedo=_colour(read_image(diffuse)),
            normal=None if normal is None else np.float32(2.0) * _colour(normal) - np.float32(1.0),
            depth=_scalar(estimate("depth", "exr")),
            roughness=_scalar(estimate("roughness", "png")),
            metallic=_scalar(estimate("metallic", "png")),
        ),
        object_maps=Intrinsics(
            albedo=np.clip(_colour(layers["albedo"]), 0.0, 1.0),
            normal=_colour(layers["normals"]) if "normals" in layers else None,
            depth=_scalar(layers.get("depth")),
            roughness=_scalar(layers.get("roughness")),
            metallic=_scalar(layers.get("metallic")),
        ),
        object_mask=np.clip(_plane(layers["mask"]), 0.0, 1.0),
        footprint_depth=_footprint(layers.get("footprint_depth")),
        truth=_colour(layers["composite"]) if "composite" in layers else None,
        name=name,
        albedo_scale="known" if _rendered(folder / META_FILE) else "unknown",
    )


def _rendered(meta: Path) -> bool:
    """Whether the set says that its maps are no estimates."""
    try:
        facts = read_json(meta) if meta.is_file() else {}
    except RecordError as error:
        raise SceneError(str(error)) from error
    return isinstance(facts, dict) and facts.get("maps") == "rendered"


def _colour(pixels: FloatArray) -> FloatArray:
    return np.ascontiguousarray(pixels[..., :3])


def _scalar(pixels: FloatArray | None) -> FloatArray | None:
    return None if pixels is None else _plane(pixels)


def _plane(pixels: FloatArray) -> FloatArray:
    """Value of a scalar map: last but one of premultiplied RGBA, any of grey RGB."""
    if pixels.ndim == 2:
        return pixels
    return np.ascontiguousarray(pixels[..., 2 if pixels.shape[2] == 4 else 0])


def _footprint(pixels: FloatArray | None) -> FloatArray | None:
    """Unpremultiplied contact depth where at least half a pixel is covered, else 0."""
    if pixels is None or pixels.ndim == 2:
        return pixels
    value, alpha = pixels[..., -2], pixels[..., -1]
    covered = alpha >= 0.5
    with np.errstate(over="ignore", invalid="ignore"):  # the scene refuses what is not finite
        return np.divide(value, alpha, out=np.zeros_like(value), where=covered)
