"""Loads glTF and OBJ objects through trimesh, as shapes with baked surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .mesh import Array, Part, Shape, bounds, rotation, transform_all

SUFFIXES = (".glb", ".gltf", ".obj")
TILE = 256
MOST_SURFACES = 8
"""More materials than this share the last one, so that a complicated file still fits the atlas."""


@dataclass(frozen=True)
class SurfaceImage:
    """A tile's content.

    Linear albedo (TILE, TILE, 3), roughness (TILE, TILE), metalness (TILE, TILE), all in [0, 1].
    """

    albedo: Array
    roughness: Array
    metallic: Array


def find_objects(folder: Path) -> dict[str, tuple[float, float, float]]:
    """Return the bounding-box sides in metres of every object below a folder, by relative path.

    Raises
    ------
    FileNotFoundError
        If there is none.
    """
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise FileNotFoundError(
            f"objects: expected {', '.join(SUFFIXES)} files in {folder}, found none. "
            "Name another folder with --objects."
        )
    sides = {}
    for path in paths:
        low, high = bounds(load_object(path)[0])
        x, y, z = (float(v) for v in high - low)
        sides[path.relative_to(folder).as_posix()] = (x, y, z)
    return sides


@lru_cache(maxsize=32)
def load_object(path: Path) -> tuple[Shape, tuple[SurfaceImage, ...]]:
    """Load one object, turned from y-up to z-up; part slots index the returned surfaces.

    Texture coordinates are shifted by whole tiles into [0, 1] a triangle at a time; what still
    sticks out is clamped, because an atlas tile cannot repeat.

    Raises
    ------
    ValueError
        If the file holds no triangles.
    """
    import trimesh

    scene = trimesh.load_scene(path)
    shape: list[Part] = []
    surfaces: list[SurfaceImage] = []
    for mesh in scene.dump():
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            continue
        if len(surfaces) < MOST_SURFACES:
            surfaces.append(_surface(getattr(mesh.visual, "material", None)))
        shape.append(_part(mesh, len(surfaces) - 1))
    if not shape:
        raise ValueError(
            f"object: expected triangles in {path}, found none. "
            "Remove the file from the --objects folder."
        )
    return transform_all(shape, rotation("x", 90.0)), tuple(surfaces)


def _part(mesh: Any, slot: int) -> Part:
    corners = np.asarray(mesh.faces).reshape(-1)
    uv = getattr(mesh.visual, "uv", None)
    uv = np.zeros((len(mesh.vertices), 2)) if uv is None else np.asarray(uv, dtype=np.float64)
    per_face = uv[corners].reshape(-1, 3, 2)
    per_face = per_face - np.floor(per_face.min(axis=1, keepdims=True) + 1e-6)
    flipped = np.clip(per_face, 0.0, 1.0) * [1.0, -1.0] + [0.0, 1.0]
    return Part(
        vertices=np.asarray(mesh.vertices, dtype=np.float64)[corners],
        faces=np.arange(len(corners)).reshape(-1, 3),
        normals=np.asarray(mesh.vertex_normals, dtype=np.float64)[corners],
        uv=flipped.reshape(-1, 2),
        slot=slot,
    )


def _surface(material: Any) -> SurfaceImage:
    """Read a glTF metallic-roughness or an OBJ diffuse material."""
    factor = _colour(getattr(material, "baseColorFactor", None))
    image = getattr(material, "baseColorTexture", None)
    roughness, metallic = (
        getattr(material, "roughnessFactor", None),
        getattr(material, "metallicFactor", None),
    )
    packed = getattr(material, "metallicRoughnessTexture", None)
    if image is None and hasattr(material, "diffuse"):
        factor, image = _colour(material.diffuse), getattr(material, "image", None)
        metallic = 0.0
    albedo = (
        np.broadcast_to(factor, (TILE, TILE, 3))
        if image is None
        else _pixels(image)[..., :3] ** 2.2 * factor
    )
    # glTF says 1 for what a file leaves out; without a texture that would make every plain object a
    # rough metal.
    rough = np.full((TILE, TILE), 0.7 if roughness is None and packed is None else roughness or 1.0)
    metal = np.full(
        (TILE, TILE),
        0.0 if metallic is None and packed is None else 1.0 if metallic is None else metallic,
    )
    if packed is not None:
        channels = _pixels(packed)
        rough, metal = rough * channels[..., 1], metal * channels[..., 2]
    return SurfaceImage(
        np.clip(albedo, 0.01, 0.95), np.clip(rough, 0.08, 1.0), np.clip(metal, 0.0, 1.0)
    )


def _colour(value: Any) -> Array:
    """Return linear RGB from a factor that may be missing, 8-bit or in [0, 1]."""
    if value is None:
        return np.full(3, 0.6)
    colour = np.asarray(value)
    scaled = colour.astype(np.float64) / (255.0 if np.issubdtype(colour.dtype, np.integer) else 1.0)
    return scaled[:3]


def _pixels(image: Any) -> Array:
    """Return a PIL image as RGB in [0, 1], shape (TILE, TILE, 3)."""
    pixels = np.asarray(image.convert("RGB"), dtype=np.float32) / 255.0
    return cv2.resize(pixels, (TILE, TILE), interpolation=cv2.INTER_AREA)
