"""Small synthetic scenes with every map, made with numpy."""

from __future__ import annotations

import numpy as np

from spotlight_runtime import Intrinsics, Scene


def make_scene(height: int = 64, width: int = 96, seed: int = 0) -> Scene:
    """A sloping floor, and a ball with an antialiased edge that stands on it."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    radius = 0.25 * min(height, width)
    dx, dy = (columns - width / 2) / radius, (rows - height / 2) / radius
    distance = np.hypot(dx, dy)
    mask = np.clip((1.0 - distance) * radius + 0.5, 0.0, 1.0).astype(np.float32)
    nz = np.sqrt(np.clip(1.0 - distance**2, 0.0, 1.0))
    ball_normal = np.stack([dx, -dy, nz], axis=-1).astype(np.float32)
    ball_normal /= np.maximum(np.linalg.norm(ball_normal, axis=-1, keepdims=True), 1.0)
    ball_depth = (3.0 - 0.5 * nz).astype(np.float32)
    foot = (mask > 0.5) & (rows > height / 2 + 0.8 * radius)
    floor_normal = np.broadcast_to(np.float32([0.0, 0.8, 0.6]), (height, width, 3)).copy()
    floor_depth = (6.0 - 3.0 * rows / height).astype(np.float32)
    noise = rng.uniform(0.2, 0.9, (height, width, 3)).astype(np.float32)
    cover = mask[..., None]
    return Scene(
        background=(0.8 * noise**2).astype(np.float32),
        background_maps=Intrinsics(
            albedo=noise,
            normal=floor_normal,
            depth=floor_depth,
            roughness=np.full((height, width), 0.7, np.float32),
            metallic=np.zeros((height, width), np.float32),
        ),
        object_maps=Intrinsics(
            albedo=cover * np.float32([0.7, 0.3, 0.2]),
            normal=cover * ball_normal,
            depth=mask * ball_depth,
            roughness=mask * np.float32(0.4),
            metallic=mask * np.float32(0.1),
        ),
        object_mask=mask,
        footprint_depth=np.where(foot, ball_depth, 0.0).astype(np.float32),
        truth=(0.5 * noise).astype(np.float32),
        field_of_view=50.0,
        name="ball",
    )


def make_shadow(scene: Scene, side: str = "left") -> np.ndarray:
    """A soft ellipse on one side of the ball."""
    height, width = scene.size
    rows, columns = np.mgrid[:height, :width]
    centre = width * (0.25 if side == "left" else 0.75)
    distance = np.hypot((columns - centre) / (0.2 * width), (rows - 0.7 * height) / (0.12 * height))
    return np.clip(1.5 - distance, 0.0, 1.0).astype(np.float32)
