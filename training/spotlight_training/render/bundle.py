"""Writes a rendered scene as a bundle of the runtime, with the object's mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spotlight_runtime import Intrinsics, Scene
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.mesh import ObjectMesh

from .assemble import assemble
from .description import SceneDescription, camera_axes
from .mesh import Array
from .record import MapSet, SceneRecord

__all__ = ["export_bundle", "to_scene"]


def to_scene(record: SceneRecord, light: str, objects: Path | None = None) -> Scene:
    """Make a scene of a record: the background under one light, the truth under the same.

    Parameters
    ----------
    record : SceneRecord
    light : str
        Name of the light.
    objects : Path, optional
        Folder of external objects, if the record's object came from one.

    Returns
    -------
    Scene
        Its photograph is exposed as `SceneRecord.exposure` does; mesh and floor in camera space.
    """
    exposure = np.float32(record.exposure({light: 1.0}))
    description = record.description
    return Scene(
        background=record.radiance({light: 1.0}, with_object=False) * exposure,
        background_maps=_maps(record.background, np.ones_like(record.object.alpha)),
        object_maps=_maps(record.object, record.object.alpha),
        object_mask=record.object.alpha,
        footprint_depth=record.footprint_depth,
        truth=record.radiance({light: 1.0}) * exposure,
        field_of_view=description.camera.fov,
        name=f"{description.subject.kind}-{description.seed}",
        object_mesh=_mesh(description, objects),
        ground=_ground(description),
    )


def export_bundle(path: Path, folder: Path, light: str, objects: Path | None = None) -> Path:
    """Write the record at ``path`` as a bundle folder and return it."""
    to_scene(SceneRecord.load(path), light, objects).save(folder)
    return folder


def _maps(layer: MapSet, cover: Array) -> Intrinsics:
    return Intrinsics(
        albedo=layer.albedo * cover[..., None],
        normal=layer.normal * cover[..., None],
        depth=layer.depth * cover,
        roughness=layer.roughness * cover,
        metallic=layer.metallic * cover,
    )


def _mesh(scene: SceneDescription, objects: Path | None) -> ObjectMesh:
    geometry = assemble(scene, objects).subject
    relative = geometry.vertices - np.asarray(scene.camera.position)
    vertices = relative @ _to_camera(scene).T
    return ObjectMesh(vertices.astype(np.float32), geometry.faces.astype(np.int32))


def _ground(scene: SceneDescription) -> Ground:
    """The plane the object stands on, floor or furniture."""
    x, y, z = (float(value) for value in _to_camera(scene)[:, 2])
    return Ground((x, y, z), scene.support_height - scene.camera.position[2])


def _to_camera(scene: SceneDescription) -> Array:
    """Rows right, up, backwards: world directions into camera space."""
    right, up, forward = camera_axes(scene.camera)
    return np.stack([right, up, -forward])
