"""Renders one described scene into a record; select the variant before importing this."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .assemble import Geometry, assemble
from .camera import camera_ray
from .denoise import Denoiser
from .description import Camera, SceneDescription
from .mesh import Array
from .record import MapSet, SceneRecord
from .sky import sky_image
from .spheres import LightTable
from .tracer import Traced, TraceSettings, trace

SKY_DEPTH = 20.0
CONTACT = 0.02
"""Share of the object's size within which it counts as touching its support (at least 8 mm)."""


@dataclass(frozen=True)
class RenderOptions:
    """Folders and quality of a run; see `TraceSettings` for the numbers."""

    side: int = 256
    spp: int = 16
    vertices: int = 3
    objects: Path | None = None
    hdris: Path | None = None


def render(
    scene: SceneDescription, options: RenderOptions, denoiser: Denoiser | None
) -> SceneRecord:
    """Render every lighting, map and shadow of a scene.

    Parameters
    ----------
    scene : SceneDescription
    options : RenderOptions
    denoiser : Denoiser, optional
        Without one the images keep their noise, which is what a reference of many samples wants.
    """
    assembly = assemble(scene, options.objects)
    back_mesh, subject_mesh = (
        upload("background", assembly.background),
        upload("subject", assembly.subject),
    )
    whole = mi.load_dict({"type": "scene", "background": back_mesh, "subject": subject_mesh})
    empty = mi.load_dict({"type": "scene", "background": back_mesh})
    alone = mi.load_dict({"type": "scene", "subject": subject_mesh})
    atlas = mi.Texture2f(mi.TensorXf(assembly.atlas))
    sky = mi.Texture2f(
        mi.TensorXf(sky_image(scene.ambient, options.hdris)), wrap_mode=dr.WrapMode.Repeat
    )
    lights = LightTable.load(scene.lights)
    # The same seed with and without the object: where it changes nothing, the two images share even
    # their noise.
    settings = TraceSettings(options.side, options.spp, options.vertices, scene.seed)
    with_object = trace(whole, scene.camera, lights, atlas, sky, settings, subject=subject_mesh)
    without = trace(empty, scene.camera, lights, atlas, sky, settings, occluder=alone)

    names = [light.name for light in scene.lights]
    lit, ambient = _clean(with_object, denoiser)
    lit_background, ambient_background = _clean(without, denoiser)
    return SceneRecord(
        description=scene,
        background=_background_maps(without),
        object=_object_maps(with_object.subject),
        footprint_depth=_footprint(
            alone, scene.camera, scene.support_height, scene.subject.size, options.side
        ),
        lights=dict(zip(names, lit, strict=True)),
        lights_background=dict(zip(names, lit_background, strict=True)),
        ambient=ambient,
        ambient_background=ambient_background,
        shadows=dict(zip(names, _shadows(without, denoiser), strict=True)),
    )


def upload(name: str, geometry: Geometry) -> Any:
    """Return a Mitsuba mesh of a geometry; the tracer reads its material from the atlas."""
    mesh = mi.Mesh(
        name,
        vertex_count=len(geometry.vertices),
        face_count=len(geometry.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    params = mi.traverse(mesh)
    params["vertex_positions"] = geometry.vertices.ravel()
    params["vertex_normals"] = geometry.normals.ravel()
    params["vertex_texcoords"] = geometry.uv.ravel()
    params["faces"] = geometry.faces.ravel()
    params.update()
    return mesh


def _clean(traced: Traced, denoiser: Denoiser | None) -> tuple[list[Array], Array]:
    """Return the denoised light images and the denoised ambient image."""
    if denoiser is None:
        return list(traced.lights), traced.ambient
    maps = _background_maps(traced)
    images = [
        denoiser.radiance(image, maps.albedo, maps.normal)
        for image in (*traced.lights, traced.ambient)
    ]
    return images[:-1], images[-1]


def _background_maps(traced: Traced) -> MapSet:
    """Fill the sky's share of every pixel, so that each one is defined."""
    sky = 1.0 - traced.hit
    towards_camera = np.array([0.0, 0.0, 1.0], dtype=np.float32)
    return MapSet(
        albedo=np.clip(traced.albedo + sky[..., None], 0, 1),
        normal=_unit(traced.normal + sky[..., None] * towards_camera),
        depth=np.minimum(traced.depth + sky * SKY_DEPTH, SKY_DEPTH),
        roughness=np.clip(traced.roughness + sky, 0, 1),
        metallic=traced.metallic,
        alpha=traced.hit,
    )


def _object_maps(subject: dict[str, Array]) -> MapSet:
    """Divide by alpha: each pixel keeps the mean over the object's own samples."""
    alpha = subject["alpha"]
    seen = alpha > 0
    share = np.where(seen, 1.0 / np.maximum(alpha, 1e-6), 0.0).astype(np.float32)
    return MapSet(
        albedo=subject["albedo"] * share[..., None],
        normal=_unit(subject["normal"]) * seen[..., None],
        depth=subject["depth"] * share,
        roughness=subject["roughness"] * share,
        metallic=subject["metallic"] * share,
        alpha=alpha,
    )


def _shadows(traced: Traced, denoiser: Denoiser | None) -> list[Array]:
    """Return 1 - with / without the occluder, for each light, clipped to [0, 1]."""
    shadows = []
    for clear, blocked in zip(traced.unshadowed, traced.shadowed, strict=True):
        reached = clear > 1e-6
        shadow = np.where(reached, 1.0 - blocked / np.maximum(clear, 1e-6), 0.0).astype(np.float32)
        if denoiser is not None and shadow.any():
            shadow = denoiser.fraction(shadow) * reached
        shadows.append(np.clip(shadow, 0.0, 1.0))
    return shadows


def _footprint(alone: Any, camera: Camera, height: float, size: float, side: int) -> Array:
    """Return the support's depth where the object stands on it.

    Rays from below its plane straight up, one a pixel.
    """
    index = dr.arange(mi.UInt32, side * side)
    x = (mi.Float(index % side) + 0.5) / side
    y = (mi.Float(index // side) + 0.5) / side
    ray, forward, _ = camera_ray(camera, x, y)
    along = (height - ray.o.z) / dr.minimum(ray.d.z, -1e-4)
    point = ray(along)
    below = 0.01
    up = mi.Ray3f(mi.Point3f(point.x, point.y, height - below), mi.Vector3f(0, 0, 1))
    up.maxt = below + max(CONTACT * size, 0.008)
    touches = alone.ray_test(up) & (ray.d.z < -1e-4)
    depth = dr.select(touches, dr.dot(point - ray.o, forward), 0)
    return depth.numpy().reshape(side, side)


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6)
