"""What rays see of a product: materials, normals and depth, through what is transparent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.materials import shade
from spotlight_runtime.composing.product import Product
from spotlight_runtime.geometry.raycast import Caster, Hits

__all__ = ["ALBEDO", "ALPHA", "CHANNELS", "DEPTH", "METALLIC", "NORMAL", "ROUGHNESS", "Tracer"]


ALBEDO: Final = slice(0, 3)
NORMAL: Final = slice(3, 6)
DEPTH, ROUGHNESS, METALLIC, ALPHA, CHANNELS = 6, 7, 8, 9, 10
"""Channels of what a ray sees, all premultiplied by the last but one, alpha."""

MOST_LAYERS: Final = 8
"""Transparent surfaces looked through, one behind the other; behind them shows the photograph."""
PASSED: Final = 0.02
"""Share of the light left at which looking further changes nothing one sees."""
STEP: Final = 1e-4
"""A ray goes on this much of its way behind a surface, to not meet it again."""
STEEPEST: Final = 0.1
"""Cosine below which a texture is not blurred further for being seen at a glancing angle."""


@dataclass(frozen=True, slots=True, eq=False)
class _Faces:
    """What is the same all over a triangle.

    Attributes
    ----------
    normal : ndarray of float32, shape (M, 3)
    density : ndarray of float32, shape (M, 2)
        Side of a unit square of each texture set, per metre.
    along : ndarray of float32, shape (M, 2, 3), optional
        Right and up of the normal map, where any material has one.
    """

    normal: FloatArray
    density: FloatArray
    along: FloatArray | None


@final
class Tracer:
    """A product in camera space, ready to be looked at.

    Parameters
    ----------
    product : Product
        Vertices and normals in camera space.
    """

    def __init__(self, product: Product) -> None:
        self._product = product
        self._caster = Caster(product.vertices, product.faces)
        self._faces = _Faces(*_face_constants(product), _tangents(product))

    def look(
        self, directions: FloatArray, pixel: float
    ) -> tuple[FloatArray, npt.NDArray[np.int32]]:
        """What rays from the camera see.

        Parameters
        ----------
        directions : ndarray of float32, shape (P, 3)
            With z = −1.
        pixel : float
            Width of a ray's cone at depth 1.

        Returns
        -------
        seen : ndarray of float32, shape (P, CHANNELS)
            `ALBEDO`, `NORMAL` (camera space, facing the camera), `DEPTH`, `ROUGHNESS`,
            `METALLIC`, `ALPHA`, premultiplied; zeros where nothing is seen.
        face : ndarray of int32, shape (P,)
            The first triangle on each ray, −1 where there is none.
        """
        face = np.full(len(directions), -1, dtype=np.int32)
        seen = np.zeros((len(directions), CHANNELS), dtype=np.float32)
        rays = np.arange(len(directions))
        start: FloatArray = np.zeros(len(directions), dtype=np.float32)
        left: FloatArray = np.ones(len(directions), dtype=np.float32)
        for layer in range(MOST_LAYERS):
            heading = directions[rays]
            hits = self._caster.cast(heading * start[:, None], heading)
            if not len(hits.ray):
                break
            rays, heading, left = rays[hits.ray], heading[hits.ray], left[hits.ray]
            if layer == 0:
                face[rays] = hits.face
            depth = start[hits.ray] + hits.distance
            values = self._surface(hits, heading, depth, pixel)
            alpha = values[:, ALPHA].copy()
            seen[rays] += values * left[:, None]
            left = left * (np.float32(1.0) - alpha)
            onward = np.flatnonzero(left > PASSED)
            if not len(onward):
                break
            rays, left = rays[onward], left[onward]
            start = depth[onward] * np.float32(1.0 + STEP)
        return seen, face

    def _surface(
        self, hits: Hits, heading: FloatArray, depth: FloatArray, pixel: float
    ) -> FloatArray:
        """Values of the surfaces hit, premultiplied by their alpha, shape (K, CHANNELS)."""
        product = self._product
        corners = product.faces[hits.face]
        weights = hits.weights
        values = np.empty((len(corners), CHANNELS), dtype=np.float32)
        sight = _unit(heading)
        facing = self._faces.normal[hits.face]
        cosine = _dot(facing, sight)
        facing = np.where((cosine > 0.0)[:, None], -facing, facing)
        normal = _mixed(product.normals, corners, weights)
        turned = _dot(normal, facing) < 0.0
        normal[turned] *= -1.0
        normal = _unit(normal)
        blur = depth * np.float32(pixel) / np.sqrt(np.maximum(np.abs(cosine), STEEPEST))
        kinds = product.face_material[hits.face]
        for kind in range(len(product.materials)):
            material = product.materials[kind]
            chosen: slice | npt.NDArray[np.intp] = slice(None)
            if len(product.materials) > 1:
                chosen = np.flatnonzero(kinds == kind)
                if not len(chosen):
                    continue
            points, shares, face = corners[chosen], weights[chosen], hits.face[chosen]
            used = sorted(material.uv_sets)
            colours = product.colours
            surface = shade(
                material,
                len(points),
                {i: _mixed(product.uv[:, i], points, shares) for i in used},
                {i: self._faces.density[face, i] * blur[chosen] for i in used},
                None if colours is None else _mixed(colours, points, shares),
            )
            values[chosen, ALBEDO] = surface.albedo
            values[chosen, ROUGHNESS] = surface.roughness
            values[chosen, METALLIC] = surface.metallic
            values[chosen, ALPHA] = surface.alpha
            if surface.bump is not None and self._faces.along is not None:
                normal[chosen] = _bumped(normal[chosen], self._faces.along[face], surface.bump)
        # Interpolated normals may lean over the rim; what is seen faces the camera.
        behind = np.maximum(_dot(normal, sight), 0.0)
        values[:, NORMAL] = _unit(normal - behind[:, None] * sight)
        values[:, DEPTH] = depth
        values[:, :ALPHA] *= values[:, ALPHA:]
        return values


def _face_constants(product: Product) -> tuple[FloatArray, FloatArray]:
    """Unit normals, and texture density."""
    corners = product.vertices[product.faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(first, second)
    area = np.linalg.norm(across, axis=1)
    uv = product.uv[product.faces]
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    covered = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    safe = np.maximum(area, np.finfo(np.float32).tiny)[:, None]
    return (across / safe).astype(np.float32), np.sqrt(covered / safe).astype(np.float32)


def _tangents(product: Product) -> FloatArray | None:
    """Directions in which the normal maps' right and up lie, not yet orthogonal."""
    if all(material.normal_texture is None for material in product.materials):
        return None
    along = np.zeros((len(product.faces), 2, 3), dtype=np.float32)
    for kind, material in enumerate(product.materials):
        if material.normal_texture is None:
            continue
        mine = np.flatnonzero(product.face_material == kind)
        corners = product.faces[mine]
        texture = material.normal_texture
        uv = product.uv[corners, texture.uv_set] @ texture.transform[:, :2].T
        points = product.vertices[corners]
        first, second = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
        a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        sign = np.sign(a[:, :1] * b[:, 1:] - a[:, 1:] * b[:, :1])
        along[mine, 0] = _unit((first * b[:, 1:] - second * a[:, 1:]) * sign)
        along[mine, 1] = _unit((first * b[:, :1] - second * a[:, :1]) * sign)
    return along


def _bumped(normal: FloatArray, along: FloatArray, bump: FloatArray) -> FloatArray:
    """Tilt normals by a normal map."""
    right = _unit(along[:, 0] - _dot(normal, along[:, 0])[:, None] * normal)
    rising = _cross(normal, right)
    # Mirrored texture coordinates turn the map's up round.
    up = bump[:, 1] * np.sign(_dot(rising, along[:, 1]))
    return _unit(bump[:, :1] * right + up[:, None] * rising + bump[:, 2:] * normal)


def _mixed(values: FloatArray, corners: npt.NDArray[np.int32], weights: FloatArray) -> FloatArray:
    """Vertex attributes, shape (N, C), between the corners, shape (K, C)."""
    mixed = values[corners[:, 0]] * weights[:, :1]
    mixed += values[corners[:, 1]] * weights[:, 1:2]
    mixed += values[corners[:, 2]] * weights[:, 2:]
    return mixed


def _unit(vectors: FloatArray) -> FloatArray:
    length = np.sqrt(_dot(vectors, vectors))
    return vectors / np.maximum(length, np.finfo(np.float32).tiny)[:, None]


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.einsum("kc,kc->k", first, second)


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """np.cross, which is slow for many short vectors."""
    ax, ay, az = first.T
    bx, by, bz = second.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)
