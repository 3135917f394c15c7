"""The background as an obstacle: what already lies in its own shadow gets none of the object's.

Only what stands between the object and a receiver counts, such as the table whose top the object
stands on, for the floor below. What stands between the light and the object, a wall for instance,
is taken to be out of the way: who asks for that light wants the object lit by it.
"""

from __future__ import annotations

from typing import Final, final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.shadows.aim import Cone
from spotlight_runtime.shadows.occluder import Occluder
from spotlight_runtime.shadows.receiver import Receiver

__all__ = ["Obstacle"]


_CELLS: Final = 128
"""Along the longer side: enough for furniture, few enough to sort in some milliseconds."""
_EDGE: Final = 0.04
"""Relative step in 1/depth, beyond what the slope on either side explains, that is an edge."""
_LIFT: Final = 1.5
"""Cells by which rays start above the surface: triangles cut the corner between floor and wall."""
_BUMPS: Final = 0.005
"""Of the depth: the unevenness of a depth map that casts no shadow."""


@final
class Obstacle:
    """The background's surface as triangles.

    Parameters
    ----------
    receiver : Receiver
    middle : ndarray of float64, shape (3,)
        Of the object, camera space.
    """

    def __init__(self, receiver: Receiver, middle: FloatArray) -> None:
        vertices, faces, step = _triangles(receiver)
        self._occluder = Occluder(vertices, faces) if len(faces) else None
        self._middle = middle.astype(np.float32)
        self._lift = np.float32(_LIFT * step / receiver.camera.focal + _BUMPS)

    def hides(self, cone: Cone, origins: FloatArray, directions: FloatArray) -> BoolArray:
        """Whether the background stands in the way, on this side of the object's middle.

        Parameters
        ----------
        cone : Cone
        origins, directions : ndarray of float32, shape (P, 3)
            Of one of its samples.

        Returns
        -------
        ndarray of bool, shape (P,)
        """
        if self._occluder is None:
            return np.zeros(len(origins), dtype=np.bool_)
        lift = self._lift / cone.patch.inverse_depth
        origins = origins + cone.patch.normals * lift[:, None]
        along = np.einsum("pc,pc->p", self._middle - origins, directions)
        reach = along / np.einsum("pc,pc->p", directions, directions)
        return self._occluder.blocks(origins, directions, np.maximum(reach, 0.0))


def _triangles(receiver: Receiver) -> tuple[FloatArray, npt.NDArray[np.int32], int]:
    """Vertices (N, 3), faces (M, 3) and the pixels along a triangle's side."""
    height, width = receiver.inverse_depth.shape
    step = -(-max(height, width) // _CELLS)
    rows, columns = np.arange(step // 2, height, step), np.arange(step // 2, width, step)
    inverse = receiver.inverse_depth[np.ix_(rows, columns)]
    depth = np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0.0)
    vertices = receiver.camera.rays()[np.ix_(rows, columns)] * depth[..., None]
    across, down = _edges(inverse), _edges(inverse.T).T
    whole = ~(across[:-1] | across[1:] | down[:, :-1] | down[:, 1:])
    index = np.arange(inverse.size, dtype=np.int32).reshape(inverse.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate(
        [np.stack([a, c, b], axis=-1)[whole], np.stack([b, c, d], axis=-1)[whole]]
    )
    return vertices.reshape(-1, 3), faces, step


def _edges(inverse: FloatArray) -> BoolArray:
    """Between which neighbours of a row the surface is cut, shape (H, W − 1)."""
    if inverse.shape[1] < 3:
        return np.ones((inverse.shape[0], max(inverse.shape[1] - 1, 0)), dtype=np.bool_)
    steps = np.diff(inverse, axis=1)
    before = np.concatenate([steps[:, 1:2], steps[:, :-1]], axis=1)
    after = np.concatenate([steps[:, 1:], steps[:, -2:-1]], axis=1)
    surprise = np.minimum(np.abs(steps - before), np.abs(steps - after))
    nearer = np.minimum(inverse[:, :-1], inverse[:, 1:])
    return np.asarray((surprise > _EDGE * nearer) | (nearer <= 0.0))
