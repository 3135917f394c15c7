"""Small scenes in the published test-set layout: a ball under eight lights, with the truths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.scenes import make_scene, make_shadow

from spotlight_runtime import Scene, write_image
from spotlight_runtime.imaging.images import write_exr_layers

AZIMUTHS = [f"{index:04d}" for index in range(8)]
ELEVATION = np.deg2rad(45.0)


def direction(index: int) -> np.ndarray:
    """Towards the light of an azimuth, in camera space: x right, y up, z towards the camera."""
    azimuth = np.deg2rad(45.0 * index)
    flat = np.cos(ELEVATION)
    return np.array([flat * np.cos(azimuth), np.sin(ELEVATION), -flat * np.sin(azimuth)])


def lit(scene: Scene, index: int, *, ambient: float = 0.2, strength: float = 0.8) -> np.ndarray:
    """The scene with its ball under a distant light: linear radiance."""
    cover = scene.object_mask[..., None]
    normal = scene.object_maps.normal / np.maximum(cover, 1e-6)
    shading = ambient + strength * np.clip(normal @ direction(index), 0.0, None)
    ball = scene.object_maps.albedo * shading[..., None]
    return (ball + (1.0 - cover) * scene.background).astype(np.float32)


def write_published(folder: Path, scene: Scene, *, truths: bool = True) -> Path:
    """Write one scene folder: bundle, estimates, shadows of nine directions, truths of eight."""
    folder.mkdir(parents=True)
    name, alpha = folder.name, scene.object_mask
    front, back = scene.object_maps, scene.background_maps

    def colour(rgb, cover=None):
        return np.dstack([rgb, np.ones_like(alpha) if cover is None else cover])

    def scalar(plane, cover=None):
        return colour(np.dstack([np.zeros_like(plane), np.zeros_like(plane), plane]), cover)

    touch = (scene.footprint_depth > 0).astype(np.float32)
    layers = {
        "albedo": colour(front.albedo, alpha),
        "background": colour(scene.background),
        "composite": colour(lit(scene, 1)),
        "depth": scalar(front.depth, alpha),
        "footprint_depth": scalar(scene.footprint_depth, touch),
        "mask": alpha,
        "metallic": scalar(front.metallic, alpha),
        "normals": colour(front.normal, alpha),
        "roughness": scalar(front.roughness, alpha),
    }
    write_exr_layers(folder / f"{name}_bundle0001.exr", layers)
    write_image(folder / f"{name}_bg_depth.exr", back.depth)
    write_image(folder / f"{name}_bg_normal.png", 0.5 + 0.5 * back.normal, bits=16)
    write_image(folder / f"{name}_bg_diffuse.png", back.albedo, bits=16)
    for index, azimuth in enumerate([*AZIMUTHS, "gt_dir"]):
        left = index % 2 == 0
        for sign, side in (("positive", left), ("negative", not left)):
            shadow = make_shadow(scene, "left" if side else "right")
            write_image(folder / f"shadow_{sign}_{azimuth}.png", shadow)
    for index, azimuth in enumerate(AZIMUTHS if truths else []):
        write_image(folder / f"truth_{azimuth}.exr", lit(scene, index))
    return folder


def write_set(root: Path, count: int = 2, *, truths: bool = True, side: int = 64) -> Path:
    """Write a test set of a few scenes."""
    for seed in range(count):
        write_published(root / f"room_{seed}", make_scene(side, side, seed), truths=truths)
    return root
