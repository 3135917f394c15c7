"""Scenes, shadows and options as hypothesis draws them, and what can be done with a scene."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from support.scenes import make_scene

from spotlight_runtime import Intrinsics, RelightOptions, Scene
from spotlight_runtime.scenes.scene import MAP_NAMES

__all__ = [
    "PLAIN",
    "SEEDS",
    "SIDES",
    "blob",
    "far_from",
    "mirrored",
    "mirrored_array",
    "options",
    "scene_of",
]

FEW = settings(
    deadline=None,
    database=None,
    derandomize=True,
    max_examples=30,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
"""The same examples each time: every one is a whole relight, or several."""
SEEDS = st.integers(0, 2**31)
SIDES = st.integers(2, 7).map(lambda n: 8 * n)
"""Of scenes whose latents have no border of their own."""
PLAIN = RelightOptions(denoise=False)


def scene_of(height: int, width: int, seed: int) -> Scene:
    """A random object of several blobs, on `make_scene`'s floor."""
    scene, rng = make_scene(height, width, seed), np.random.default_rng(seed)
    mask = np.maximum(blob(height, width, rng), blob(height, width, rng))
    cover = mask[..., None]
    albedo = rng.uniform(0.1, 0.9, (height, width, 3)).astype(np.float32)
    normal = rng.normal(size=(height, width, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    depth = rng.uniform(2.0, 4.0, (height, width)).astype(np.float32)
    foot = np.where(mask > 0.5, depth, 0.0) * (np.arange(height)[:, None] > height // 2)
    maps = replace(
        scene.object_maps,
        albedo=cover * albedo,
        normal=cover * normal,
        depth=mask * depth,
        roughness=mask * np.float32(0.3),
        metallic=mask * np.float32(0.2),
    )
    return replace(
        scene, object_maps=maps, object_mask=mask, footprint_depth=foot.astype(np.float32)
    )


def blob(height: int, width: int, rng: np.random.Generator) -> np.ndarray:
    """A soft ellipse somewhere, shape (height, width), in [0, 1]; may reach over the border."""
    rows, columns = np.mgrid[:height, :width]
    y, x = rng.uniform(0, height), rng.uniform(0, width)
    distance = np.hypot(
        (rows - y) / (rng.uniform(0.08, 0.4) * height),
        (columns - x) / (rng.uniform(0.08, 0.4) * width),
    )
    return np.clip(rng.uniform(1.0, 2.0) - distance, 0.0, 1.0).astype(np.float32)


def far_from(region: np.ndarray, margin: int = 8) -> np.ndarray:
    """Pixels further than the composite's soft border from a region."""
    square = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return cv2.dilate(region.astype(np.uint8), square) == 0


@st.composite
def options(draw: st.DrawFn, **fixed: object) -> RelightOptions:
    """Anything a person may ask for that works on a small picture."""
    chosen = {
        "gamma": draw(st.floats(0.0, 15.0)),
        "beta": draw(st.floats(0.0, 1.0)),
        "seed": draw(st.integers(0, 2**63 - 1)),
        "steps": draw(st.integers(1, 5)),
        "solver": draw(st.sampled_from(["ddim", "dpmpp_2m", "unipc"])),
        "guidance_rescale": draw(st.sampled_from([0.0, 0.7, 1.0])),
        "shadow_opacity": draw(st.floats(0.0, 1.0)),
        "batch_branches": draw(st.booleans()),
        "skip": draw(st.booleans()),
    }
    return replace(PLAIN, **(chosen | fixed))


def mirrored_array(array: np.ndarray | None, axis: int) -> np.ndarray | None:
    """Turned over along an axis."""
    return None if array is None else np.ascontiguousarray(np.flip(array, axis))


def mirrored(scene: Scene, axis: int) -> Scene:
    """The scene in a mirror: left for right (axis 1), or up for down (axis 0)."""

    def turned(maps: Intrinsics) -> Intrinsics:
        values = {name: mirrored_array(getattr(maps, name), axis) for name in MAP_NAMES}
        if values["normal"] is not None:
            values["normal"][..., 0 if axis == 1 else 1] *= -1.0
        return Intrinsics(**values)

    return replace(
        scene,
        background=mirrored_array(scene.background, axis),
        background_maps=turned(scene.background_maps),
        object_maps=turned(scene.object_maps),
        object_mask=mirrored_array(scene.object_mask, axis),
        footprint_depth=mirrored_array(scene.footprint_depth, axis),
        truth=None,
    )
