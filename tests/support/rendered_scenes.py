"""Scenes of the training renderer as the runtime sees them, to judge it by true shadows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spotlight_runtime import Intrinsics, Scene
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_training.render.assemble import item_shape
from spotlight_training.render.description import camera_axes
from spotlight_training.render.record import SceneRecord


def in_camera_space(record: SceneRecord, points) -> np.ndarray:
    """World points, shape (N, 3), in the camera space of the runtime."""
    camera = record.description.camera
    right, up, forward = camera_axes(camera)
    relative = np.asarray(points) - np.asarray(camera.position)
    return np.stack([relative @ right, relative @ up, -(relative @ forward)], axis=1)


def scene_of(record: SceneRecord) -> Scene:
    """The scene with the object's mesh; its floor is left for the runtime to find."""
    parts = item_shape(record.description.subject)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    vertices = in_camera_space(record, np.concatenate([part.vertices for part in parts]))
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts)])
    back, front, alpha = record.background, record.object, record.object.alpha
    return Scene(
        background=record.ambient_background,
        background_maps=Intrinsics(back.albedo, back.normal, back.depth),
        object_maps=Intrinsics(
            front.albedo * alpha[..., None], front.normal * alpha[..., None], front.depth * alpha
        ),
        object_mask=alpha,
        footprint_depth=record.footprint_depth,
        field_of_view=record.description.camera.fov,
        object_mesh=ObjectMesh(vertices.astype(np.float32), faces.astype(np.int32)),
        name=f"{record.description.split} {record.description.seed}",
    )


def light_of(record: SceneRecord, name: str, object_size: float) -> Light:
    """A light of the scene, where the renderer put it."""
    light = next(each for each in record.description.lights if each.name == name)
    x, y, z = (float(v) for v in in_camera_space(record, [light.position])[0])
    return Light(position=(x, y, z), frame="camera", radius=light.radius / object_size)


def render_records(folder: Path, seeds: range, side: int = 256, spp: int = 64) -> list[Path]:
    """Render held-out scenes without bounces or denoiser: maps and direct shadows count."""
    from spotlight_training.render.pipeline import RenderOptions, render
    from spotlight_training.render.record import is_whole, record_path
    from spotlight_training.render.scenes import SceneOptions, describe

    paths = []
    for seed in seeds:
        path = record_path(folder, "val", seed)
        if not is_whole(path):
            scene = describe("val", seed, SceneOptions(use_hdris=False))
            render(scene, RenderOptions(side=side, spp=spp, vertices=1), None).save(path)
        paths.append(path)
    return paths
