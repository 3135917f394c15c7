"""A path tracer that carries every light at once.

One set of paths, one radiance image a light and one for the ambient.

At the first vertex each light is sampled by itself, with multiple importance sampling against the
surface model; at later vertices one light is picked at random. All images so share their camera
rays, bounces and most of their cost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .bsdf import Surface, evaluate, sample
from .camera import camera_ray, opaque, ray_offset
from .description import Camera
from .mesh import Array
from .spheres import LightTable

INDIRECT_LIMIT = 6.0
"""Most that one path may add beyond the first vertex: a small loss of energy for the absence of
fireflies."""


@dataclass(frozen=True)
class TraceSettings:
    """Image side in pixels, samples a pixel (a square), vertices a path, sampler's seed."""

    side: int = 256
    spp: int = 16
    vertices: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        if self.spp < 1 or math.isqrt(self.spp) ** 2 != self.spp:
            raise ValueError(
                f"spp: expected a square number such as 4, 16 or 64, got {self.spp}. "
                "Pixels are stratified n by n."
            )


@dataclass(frozen=True)
class Traced:
    """Pixel averages, float32, first axis the image's rows.

    Attributes
    ----------
    lights : array, shape (L, H, W, 3)
        Linear radiance, one image a light.
    ambient : array, shape (H, W, 3)
    hit : array, shape (H, W)
        Share of the pixel's samples that meet a surface.
    albedo, normal : array, shape (H, W, 3)
        Summed over the samples that hit, over all samples (premultiplied); normals in camera space.
    depth, roughness, metallic : array, shape (H, W)
        Premultiplied likewise; depth along the optical axis in metres.
    subject : dict of str to array
        `alpha`, and the five maps above for the subject's samples only.
    unshadowed, shadowed : array, shape (L, H, W)
        Irradiance of a light on the surfaces as they are, and with the occluder in its way;
        arbitrary common unit.
    """

    lights: Array
    ambient: Array
    hit: Array
    albedo: Array
    normal: Array
    depth: Array
    roughness: Array
    metallic: Array
    subject: dict[str, Array]
    unshadowed: Array
    shadowed: Array


def trace(
    scene: Any,
    camera: Camera,
    lights: LightTable,
    atlas: Any,
    sky: Any,
    settings: TraceSettings,
    subject: Any = None,
    occluder: Any = None,
) -> Traced:
    """Trace a scene once for all lights.

    Parameters
    ----------
    scene : mitsuba.Scene
        What is seen and what blocks light.
    camera : Camera
    lights : LightTable
    atlas, sky : mitsuba.Texture2f
        The surfaces' texture, and the equirectangular ambient radiance.
    settings : TraceSettings
    subject : mitsuba.Mesh, optional
        The mesh of `scene` that is the inserted object.
    occluder : mitsuba.Scene, optional
        Casts into `shadowed` only.
    """
    sampler = mi.load_dict({"type": "multijitter", "sample_count": settings.spp})
    sampler.set_samples_per_wavefront(settings.spp)
    sampler.seed(settings.seed, settings.side**2 * settings.spp)
    ray, forward, to_camera = _camera_rays(camera, settings, sampler)
    si = scene.ray_intersect(ray)
    valid = si.is_valid()
    surface, frame, wi = _vertex(si, atlas)
    position = dr.select(valid, si.p, 0)

    radiance = [mi.Color3f(0) for _ in range(lights.count)]
    clear, blocked = [], []
    for k in range(lights.count):
        light = lights.row(k)
        direction, reach, density = light.sample(position, sampler.next_2d())
        value, other = evaluate(surface, wi, frame.to_local(direction))
        shadow_ray = si.spawn_ray(direction)
        shadow_ray.maxt = reach * (1 - 1e-3)
        lit = valid & (dr.dot(direction, frame.n) > 0)
        lit &= ~scene.ray_test(shadow_ray, lit)
        radiance[k] = dr.select(lit, value * light.radiance / (density + other), 0)
        if occluder is not None:
            irradiance = dr.select(lit, dr.dot(direction, frame.n) / density, 0)
            clear.append(irradiance)
            blocked.append(dr.select(occluder.ray_test(shadow_ray, lit), 0, irradiance))

    ambient = dr.select(valid, 0, _sky(sky, ray.d))
    wo, throughput, density = sample(surface, wi, sampler.next_1d(), sampler.next_2d())
    ray = si.spawn_ray(frame.to_world(wo))
    gains, sky_gain = _bounces(
        scene, lights, atlas, sky, sampler, settings, (valid, ray, throughput, density)
    )
    radiance = [direct + gain for direct, gain in zip(radiance, gains, strict=True)]
    ambient += sky_gain

    one = dr.select(valid, mi.Float(1), 0)
    z_depth = dr.dot(ray_offset(si.p, camera), forward)
    gathered = {
        "albedo": surface.base,
        "normal": to_camera(frame.n),
        "depth": z_depth,
        "roughness": dr.sqrt(surface.alpha),
        "metallic": surface.metallic,
    }
    outputs: dict[str, Any] = {"hit": one, "ambient": ambient}
    outputs |= {name: dr.select(valid, value, 0) for name, value in gathered.items()}
    outputs |= {f"light{k}": value for k, value in enumerate(radiance)}
    outputs |= {f"clear{k}": value for k, value in enumerate(clear)}
    outputs |= {f"blocked{k}": value for k, value in enumerate(blocked)}
    if subject is not None:
        own = valid & (si.shape == mi.ShapePtr(subject))
        outputs["subject_alpha"] = dr.select(own, mi.Float(1), 0)
        outputs |= {f"subject_{name}": dr.select(own, value, 0) for name, value in gathered.items()}
    return _collect(outputs, settings, lights.count)


def _camera_rays(camera: Camera, settings: TraceSettings, sampler: Any) -> tuple[Any, Any, Any]:
    pixel = dr.arange(mi.UInt32, settings.side**2 * settings.spp) // settings.spp
    jitter = sampler.next_2d()
    x = (mi.Float(pixel % settings.side) + jitter.x) / settings.side
    y = (mi.Float(pixel // settings.side) + jitter.y) / settings.side
    return camera_ray(camera, x, y)


def _vertex(si: Any, atlas: Any) -> tuple[Surface, Any, Any]:
    """Return the surface, the shading frame on the ray's side, and the local view direction."""
    normal = si.sh_frame.n
    normal = dr.select(dr.dot(si.n, si.to_world(si.wi)) < 0, -normal, normal)
    frame = mi.Frame3f(normal)
    wi = frame.to_local(si.to_world(si.wi))
    # A smoothed normal may turn away from the eye at a silhouette; there the surface is seen edge
    # on.
    wi.z = dr.maximum(wi.z, 1e-3)
    return Surface.lookup(atlas, si.uv), frame, dr.normalize(wi)


def _bounces(
    scene: Any,
    lights: LightTable,
    atlas: Any,
    sky: Any,
    sampler: Any,
    settings: TraceSettings,
    start: tuple[Any, Any, Any, Any],
) -> tuple[list[Any], Any]:
    """Follow paths from the first vertex; return what every light and the sky add to it.

    `start` is the mask of live paths, their next ray, their throughput and the density they were
    sampled with.
    """
    valid, ray, throughput, density = start
    last = opaque(mi.UInt32, settings.vertices)

    def body(
        active: Any,
        ray: Any,
        throughput: Any,
        density: Any,
        step: Any,
        sampler: Any,
        gains: list[Any],
        ambient: Any,
    ) -> tuple[Any, ...]:
        si = scene.ray_intersect(ray, active)
        found = active & si.is_valid()
        ambient = ambient + dr.select(active & ~found, throughput * _sky(sky, ray.d), 0)
        # Sampled lights and met lights share the first vertex; later ones are only sampled.
        first = active & (step == 1)
        index = dr.minimum(mi.UInt32(sampler.next_1d() * lights.count), lights.count - 1)
        light = lights.row(index)
        surface, frame, wi = _vertex(si, atlas)
        direction, reach, pdf = light.sample(si.p, sampler.next_2d())
        value, _ = evaluate(surface, wi, frame.to_local(direction))
        shadow_ray = si.spawn_ray(direction)
        shadow_ray.maxt = reach * (1 - 1e-3)
        lit = found & (dr.dot(direction, frame.n) > 0) & (step < last)
        lit &= ~scene.ray_test(shadow_ray, lit)
        gain = dr.select(lit, throughput * value * light.radiance * (lights.count / pdf), 0)
        gain = dr.minimum(gain, INDIRECT_LIMIT)
        summed = []
        for k in range(lights.count):
            own = lights.row(k)
            met, met_reach, other = own.meet(ray.o, ray.d)
            seen = first & met & (met_reach < si.t)
            direct = dr.select(seen, throughput * own.radiance * (density / (density + other)), 0)
            summed.append(gains[k] + direct + dr.select(index == k, gain, 0))
        wo, weight, density = sample(surface, wi, sampler.next_1d(), sampler.next_2d())
        throughput = throughput * weight
        step = step + 1
        active = found & (step <= last) & (dr.max(throughput) > 1e-4)
        return (
            active,
            si.spawn_ray(frame.to_world(wo)),
            throughput,
            density,
            step,
            sampler,
            summed,
            ambient,
        )

    gains = [mi.Color3f(0) for _ in range(lights.count)]
    state = (mi.Mask(valid), ray, throughput, density, mi.UInt32(1), sampler, gains, mi.Color3f(0))
    final = dr.while_loop(state, lambda active, *_: active, body, label="bounces")
    return final[6], final[7]


def _sky(sky: Any, direction: Any) -> Any:
    """Look up the ambient radiance in a world direction: u by azimuth, v from zenith to nadir."""
    u = dr.atan2(direction.y, direction.x) * dr.inv_two_pi
    v = dr.safe_acos(direction.z) * dr.inv_pi
    return mi.Color3f(sky.eval(mi.Point2f(u - dr.floor(u), v)))


def _collect(outputs: dict[str, Any], settings: TraceSettings, count: int) -> Traced:
    """Average samples into pixels and bring them to numpy."""
    # Evaluated together first: a block sum would otherwise trace all the paths again for its one
    # channel.
    dr.eval(outputs)
    flat: dict[str, Any] = {}
    for name, value in outputs.items():
        channels = (
            [value]
            if dr.size_v(type(value)) in (dr.Dynamic, 1) and dr.depth_v(value) == 1
            else list(value)
        )
        flat[name] = [dr.block_sum(channel, settings.spp) for channel in channels]
    dr.eval(*(channel for channels in flat.values() for channel in channels))
    images: dict[str, Array] = {}
    for name, channels in flat.items():
        planes = [channel.numpy().reshape(settings.side, settings.side) for channel in channels]
        images[name] = (planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)) / np.float32(
            settings.spp
        )
    shape = (0, settings.side, settings.side)

    def stacked(stem: str) -> Array:
        found = [images[f"{stem}{k}"] for k in range(count) if f"{stem}{k}" in images]
        return np.stack(found) if found else np.zeros(shape, dtype=np.float32)

    return Traced(
        lights=stacked("light"),
        ambient=images["ambient"],
        **{
            name: images[name]
            for name in ("hit", "albedo", "normal", "depth", "roughness", "metallic")
        },
        subject={
            name.removeprefix("subject_"): image
            for name, image in images.items()
            if name.startswith("subject_")
        },
        unshadowed=stacked("clear"),
        shadowed=stacked("blocked"),
    )
