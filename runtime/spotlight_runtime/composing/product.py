"""A product: triangles with normals, texture coordinates and materials, from whatever file.

Model space is glTF's: y up, the front towards +z, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.materials import Material
from spotlight_runtime.errors import ProductError

__all__ = ["Piece", "Product", "assemble", "smooth_normals", "weld"]


CREASE_DEGREES: Final = 40.0
"""Faces that meet at less than this share a smooth normal where a file has none."""
SMALLEST_NORMAL: Final = 1e-12
MAX_TRIANGLES: Final = 10_000_000
"""More would take longer to read than a person waits, and gigabytes."""
MOST_SHARING: Final = 1024
"""Corners at one position that are compared pair by pair; a sphere's pole has hundreds. Where more
meet, as in a damaged file whose vertices are all the same, they keep their faces' flat normals."""
PAIRS: Final = 1 << 22
"""Compared at a time, in some hundreds of megabytes."""

_PRIMES: Final = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64
)


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Triangles of one material.

    Attributes
    ----------
    vertices : ndarray of float32, shape (N, 3)
    faces : ndarray of int32, shape (M, 3)
    material : Material
    normals : ndarray of float32, shape (N, 3), optional
        Of any length.
    uv : ndarray of float32, shape (N, 2, 2), optional
        Two sets of texture coordinates; v points down.
    colours : ndarray of float32, shape (N, 4), optional
        Linear.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.int32]
    material: Material
    normals: FloatArray | None = None
    uv: FloatArray | None = None
    colours: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Product:
    """A whole model.

    Attributes
    ----------
    vertices, normals : ndarray of float32, shape (N, 3)
        Metres; unit length.
    faces : ndarray of int32, shape (M, 3)
    uv : ndarray of float32, shape (N, 2, 2)
    colours : ndarray of float32, shape (N, 4), optional
    materials : tuple of Material
    face_material : ndarray of int32, shape (M,)
        Rows of ``materials``.
    name : str
    """

    vertices: FloatArray
    normals: FloatArray
    faces: npt.NDArray[np.int32]
    uv: FloatArray
    colours: FloatArray | None
    materials: tuple[Material, ...]
    face_material: npt.NDArray[np.int32]
    name: str = "object"

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest corner of what the faces use, each of shape (3,)."""
        used = self.vertices[np.unique(self.faces)]
        return used.min(axis=0), used.max(axis=0)


def assemble(pieces: Sequence[Piece], name: str) -> Product:
    """Join pieces, after checking that they are a surface that can be seen.

    Parameters
    ----------
    pieces : sequence of Piece
    name : str
        Named in errors.

    Raises
    ------
    ProductError
        If there are no triangles, vertices hold NaN or infinity, faces name vertices that are not
        there, or everything lies in one point or line.
    """
    whole = [_complete(piece, name) for piece in pieces if len(piece.faces)]
    if not whole:
        raise ProductError(
            f"{name}: expected triangles, found an empty mesh; export the model with its faces"
        )
    offsets = np.cumsum([0, *(len(piece.vertices) for piece in whole)])
    faces = np.concatenate([piece.faces + offset for piece, offset in zip(whole, offsets)])
    if len(faces) > MAX_TRIANGLES:
        raise ProductError(
            f"{name}: expected at most {MAX_TRIANGLES} triangles, got {len(faces)}; "
            "decimate the model first"
        )
    kinds = {id(piece.material): piece.material for piece in whole}
    rows = {key: row for row, key in enumerate(kinds)}
    coloured = any(piece.colours is not None for piece in whole)
    product = Product(
        vertices=np.concatenate([piece.vertices for piece in whole]),
        normals=np.concatenate([_given(piece.normals) for piece in whole]),
        faces=faces.astype(np.int32),
        uv=np.concatenate([_given(piece.uv) for piece in whole]),
        colours=np.concatenate([_colours(piece) for piece in whole]) if coloured else None,
        materials=tuple(kinds.values()),
        face_material=np.concatenate(
            [np.full(len(p.faces), rows[id(p.material)], dtype=np.int32) for p in whole]
        ),
        name=name,
    )
    low, high = product.bounds
    sides = np.sort(high.astype(np.float64) - low)
    if sides[1] <= 1e-6 * sides[2]:
        raise ProductError(
            f"{name}: expected a surface, got a mesh without extent "
            f"({sides[2]:g} × {sides[1]:g} × {sides[0]:g} m); export the model again"
        )
    return product


def smooth_normals(vertices: FloatArray, faces: npt.NDArray[np.int32]) -> FloatArray:
    """Normals of each face's corners, smooth but across creases.

    Parameters
    ----------
    vertices : ndarray of float32, shape (N, 3)
    faces : ndarray of int32, shape (M, 3)

    Returns
    -------
    ndarray of float32, shape (M, 3, 3)
        Unit length, by face and corner: the area-weighted mean over the faces that share the
        corner's position at less than `CREASE_DEGREES`.
    """
    corners = vertices[faces].astype(np.float64)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = _unit(area)
    at = weld(vertices)[faces].reshape(-1)  # position of each corner
    order = np.argsort(at, kind="stable")
    counts = np.bincount(at)
    order = order[counts[at[order]] <= MOST_SHARING]
    counts = np.where(counts <= MOST_SHARING, counts, 0)
    start = np.concatenate([[0], np.cumsum(counts)])
    total = np.zeros((len(at), 3))
    ends = np.flatnonzero(np.diff(np.cumsum(counts[at[order]]) // PAIRS)) + 1
    for corner in np.split(order, ends):
        # Every pair of these and the corners at their positions, as two flat lists.
        valence = counts[at[corner]]
        first = np.repeat(np.arange(len(corner)), valence)
        within = np.arange(len(first)) - np.repeat(np.cumsum(valence) - valence, valence)
        mine, other = corner[first], order[start[at[corner[first]]] + within]
        alike = np.einsum("ij,ij->i", flat[mine // 3], flat[other // 3])
        near = alike >= np.cos(np.radians(CREASE_DEGREES))
        first, other = first[near], other[near]
        for axis in range(3):
            summed = np.bincount(first, area[other // 3, axis], len(corner))
            total[corner, axis] = summed
    empty = np.linalg.norm(total, axis=1) < SMALLEST_NORMAL
    total[empty] = np.repeat(flat, 3, axis=0)[empty]
    return _unit(total).reshape(-1, 3, 3).astype(np.float32)


def weld(vertices: FloatArray) -> npt.NDArray[np.int64]:
    """Number vertices so that those in one place share a number.

    Parameters
    ----------
    vertices : ndarray of float32, shape (N, 3)

    Returns
    -------
    ndarray of int64, shape (N,)
    """
    # Sorting one hash a vertex is ten times faster than sorting rows; + 0 makes −0 into 0.
    bits = np.ascontiguousarray(vertices + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    mixed = bits[:, 0] * _PRIMES[0] + bits[:, 1] * _PRIMES[1] + bits[:, 2] * _PRIMES[2]
    return np.unique(mixed, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _usable(lengths: FloatArray) -> bool:
    """Whether all normals of these lengths say a direction."""
    return bool((np.isfinite(lengths) & (lengths > SMALLEST_NORMAL)).all())


def _complete(piece: Piece, name: str) -> Piece:
    """Check one piece and give it what it lacks."""
    faces = piece.faces
    if faces.min() < 0 or faces.max() >= len(piece.vertices):
        raise ProductError(
            f"{name}: expected faces of {len(piece.vertices)} vertices, got indices from "
            f"{faces.min()} to {faces.max()}; export the model again"
        )
    bad = int((~np.isfinite(piece.vertices)).any(axis=1).sum())
    if bad:
        raise ProductError(
            f"{name}: {bad} of {len(piece.vertices)} vertices are NaN or infinite; "
            "repair the mesh or export the model again"
        )
    uv = piece.uv if piece.uv is not None else np.zeros((len(piece.vertices), 2, 2), np.float32)
    if not np.isfinite(uv).all():
        raise ProductError(
            f"{name}: texture coordinates are NaN or infinite; export the model again"
        )
    colours = None if piece.colours is None else np.clip(np.nan_to_num(piece.colours), 0.0, 1.0)
    normals = piece.normals
    lengths = None if normals is None else np.linalg.norm(normals.astype(np.float64), axis=1)
    if normals is not None and lengths is not None and _usable(lengths):
        unit = (normals / lengths[:, None]).astype(np.float32)
        return Piece(piece.vertices, faces, piece.material, unit, uv, colours)
    # Without usable normals each corner becomes a vertex of its own.
    spread = faces.reshape(-1)
    return Piece(
        vertices=piece.vertices[spread],
        faces=np.arange(len(spread), dtype=np.int32).reshape(-1, 3),
        material=piece.material,
        normals=smooth_normals(piece.vertices, faces).reshape(-1, 3),
        uv=uv[spread],
        colours=None if colours is None else colours[spread],
    )


def _colours(piece: Piece) -> FloatArray:
    if piece.colours is None:
        return np.ones((len(piece.vertices), 4), dtype=np.float32)
    return piece.colours


def _given(value: FloatArray | None) -> FloatArray:
    assert value is not None, "completed pieces have every attribute"
    return value


def _unit(vectors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), SMALLEST_NORMAL)
