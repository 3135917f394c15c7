"""What blocks light: triangles, asked along many rays at once. Needs the extra ``scene``."""

from __future__ import annotations

import importlib.util
from typing import Any, final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.errors import MissingExtraError

__all__ = ["Occluder", "require_ray_casting"]


def require_ray_casting() -> None:
    """Raise unless the optional ray caster is installed.

    Raises
    ------
    MissingExtraError
        Naming the pip command.
    """
    if importlib.util.find_spec("embreex") is None:
        raise MissingExtraError(
            "casting shadows needs Embree: pip install 'spotlight-relight[scene]', "
            "or draw the shadow and give it as an image (--shadow, --scribble)"
        )


@final
class Occluder:
    """Triangles in a search tree.

    Parameters
    ----------
    vertices : ndarray of float32, shape (N, 3)
    faces : ndarray of int32, shape (M, 3)

    Raises
    ------
    MissingExtraError
        If Embree is not installed.
    """

    def __init__(self, vertices: FloatArray, faces: npt.NDArray[np.int32]) -> None:
        require_ray_casting()
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # Robust, so that no ray slips through the edge between two triangles.
        self._scene: Any = EmbreeScene(robust=True)
        TriangleMesh(self._scene, np.ascontiguousarray(vertices), np.ascontiguousarray(faces))

    def blocks(
        self, origins: FloatArray, directions: FloatArray, reach: FloatArray | float
    ) -> BoolArray:
        """Whether anything lies on each ray.

        Parameters
        ----------
        origins, directions : ndarray of float32, shape (P, 3)
        reach : float, or ndarray of float32, shape (P,)
            How far along each ray to look, in lengths of its direction.

        Returns
        -------
        ndarray of bool, shape (P,)
        """
        hits = self._scene.run(
            np.ascontiguousarray(origins),
            np.ascontiguousarray(directions),
            dists=np.array(np.broadcast_to(reach, len(origins)), dtype=np.float32),
            query="OCCLUDED",
        )
        return np.asarray(hits >= 0)
