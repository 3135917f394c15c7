"""What a ray sees first: triangles in a search tree. Needs the extra ``scene``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray

__all__ = ["Caster", "Hits"]


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Where rays meet a surface; one row for each ray that does.

    Attributes
    ----------
    ray, face : ndarray of int, shape (K,)
    distance : ndarray of float32, shape (K,)
        In lengths of the ray's direction.
    weights : ndarray of float32, shape (K, 3)
        Barycentric: how much of each of the face's corners.
    """

    ray: npt.NDArray[np.intp]
    face: npt.NDArray[np.intp]
    distance: FloatArray
    weights: FloatArray


@final
class Caster:
    """Triangles in a search tree.

    Parameters
    ----------
    vertices : ndarray of float32, shape (N, 3)
    faces : ndarray of int32, shape (M, 3)
    """

    def __init__(self, vertices: FloatArray, faces: npt.NDArray[np.int32]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # Robust, so that no ray slips through the edge between two triangles.
        self._scene: Any = EmbreeScene(robust=True)
        TriangleMesh(self._scene, np.ascontiguousarray(vertices), np.ascontiguousarray(faces))

    def cast(self, origins: FloatArray, directions: FloatArray) -> Hits:
        """First hits of rays.

        Parameters
        ----------
        origins, directions : ndarray of float32, shape (P, 3)
        """
        found = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), output=True
        )
        ray = np.flatnonzero(found["primID"] >= 0)
        u, v = found["u"][ray], found["v"][ray]
        return Hits(
            ray=ray,
            face=found["primID"][ray].astype(np.intp),
            distance=found["tfar"][ray],
            weights=np.stack([np.float32(1.0) - u - v, u, v], axis=1),
        )
