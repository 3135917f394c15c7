"""The object's mesh in a bundle: ``.npz`` by numpy alone, glTF and OBJ through trimesh."""

from __future__ import annotations

import importlib.util
import os
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import MissingExtraError, SceneError
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_spec import replacing

__all__ = ["read_mesh", "write_mesh"]


MAX_MESH_BYTES: Final = 1 << 29
"""Of an unpacked ``.npz``: more than ten million triangles, and less than any machine's memory."""

_THROUGH_TRIMESH: Final = (".glb", ".gltf", ".obj", ".ply", ".stl")


def read_mesh(path: Path, pose: npt.NDArray[np.float64] | None = None) -> ObjectMesh:
    """Read a mesh and place it in camera space.

    Parameters
    ----------
    path : Path
        ``.npz`` with ``vertices`` and ``faces``, or a model file (needs the extra ``scene``).
    pose : ndarray of float64, shape (4, 4), optional
        From the file's coordinates to camera space, acting on columns.

    Raises
    ------
    SceneError
        If there is no such mesh, or the pose is none.
    MissingExtraError
        If the file needs trimesh and it is not installed.
    InvalidInputError
        If the mesh is empty, not finite, or its faces name vertices it has not.
    """
    suffix = path.suffix.lower()
    if suffix not in (".npz", *_THROUGH_TRIMESH):
        known = ", ".join((".npz", *_THROUGH_TRIMESH))
        raise SceneError(f"{path}: expected a mesh as one of {known}, got {path.suffix!r}")
    if not os.path.isfile(path):  # unlike Path.is_file, False for impossible names too
        raise SceneError(f"{path}: expected the object's mesh, found no file")
    vertices, faces = _read_npz(path) if suffix == ".npz" else _read_model(path)
    if pose is not None and not np.allclose(pose[3], [0, 0, 0, 1]):
        raise SceneError(f"{path}: expected a pose whose last row is 0 0 0 1, got {pose[3]}")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # the mesh refuses what is not finite
            if pose is not None:
                vertices = vertices @ pose[:3, :3].T + pose[:3, 3]
            return ObjectMesh(vertices.astype(np.float32), faces.astype(np.int32))
    except ValueError as error:
        error.args = (f"{path}: {error}",)
        raise


def write_mesh(path: Path, mesh: ObjectMesh) -> None:
    """Write a mesh as ``.npz``."""
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, vertices=mesh.vertices, faces=mesh.faces)


def _read_npz(path: Path) -> tuple[FloatArray, npt.NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_MESH_BYTES:
            raise SceneError(
                f"{path}: unpacks to {size} bytes, more than the limit of {MAX_MESH_BYTES}; "
                "simplify the model"
            )
        with np.load(path, allow_pickle=False) as arrays:
            vertices, faces = arrays["vertices"], arrays["faces"]
    except SceneError:
        raise
    except Exception as error:  # what numpy, zipfile and zlib raise shares no base class
        raise SceneError(f"{path}: expected arrays vertices and faces, got {error}") from error
    if vertices.dtype.kind != "f" or faces.dtype.kind not in "iu":
        raise SceneError(
            f"{path}: expected vertices as floats and faces as integers, "
            f"got {vertices.dtype} and {faces.dtype}"
        )
    # Rows that int32 cannot name become rows that no mesh has.
    most = np.iinfo(np.int32).max
    return vertices, np.where((faces >= 0) & (faces <= most), faces, -1).astype(np.int64)


def _read_model(path: Path) -> tuple[FloatArray, npt.NDArray[Any]]:
    if importlib.util.find_spec("trimesh") is None:
        raise MissingExtraError(
            f"{path}: reading {path.suffix} needs trimesh: pip install 'spotlight-relight[scene]'"
        )
    import trimesh

    try:
        mesh = trimesh.load_scene(path, skip_materials=True).to_mesh()
        return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # its readers raise whatever the damage leads to
        raise SceneError(f"{path}: cannot be read as a model: {error}") from error
