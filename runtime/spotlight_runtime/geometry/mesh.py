"""The inserted object as triangles, placed in camera space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import DtypeError, InvalidInputError, NonFiniteError, ShapeError

__all__ = ["ObjectMesh"]


@dataclass(frozen=True, slots=True, eq=False)
class ObjectMesh:
    """A triangle mesh where it stands in the picture.

    Attributes
    ----------
    vertices : ndarray of float32, shape (N, 3)
        Camera space (x right, y up, z towards the camera), in the unit of the depth maps.
    faces : ndarray of int32, shape (M, 3)
        Rows of ``vertices``; either orientation.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.int32]

    def __post_init__(self) -> None:
        _check(self.vertices, "object_mesh vertices", np.float32)
        _check(self.faces, "object_mesh faces", np.int32)
        bad = int((~np.isfinite(self.vertices)).any(axis=1).sum())
        if bad:
            raise NonFiniteError(
                f"object_mesh vertices: {bad} of {len(self.vertices)} are NaN or infinite; "
                "repair or re-export the model"
            )
        if not np.ptp(self.vertices, axis=0).any():
            raise InvalidInputError(
                "object_mesh vertices: expected a body, got all of them in one point; check the "
                "model's scale"
            )
        low, high = int(self.faces.min()), int(self.faces.max())
        if low < 0 or high >= len(self.vertices):
            raise InvalidInputError(
                f"object_mesh faces: expected rows of {len(self.vertices)} vertices, "
                f"got indices from {low} to {high}"
            )


def _check(value: npt.NDArray[Any], name: str, dtype: type) -> None:
    if not isinstance(value, np.ndarray) or value.dtype != dtype:
        got = getattr(value, "dtype", type(value).__name__)
        raise DtypeError(f"{name}: expected a {np.dtype(dtype)} array, got {got}; convert it first")
    if value.ndim != 2 or value.shape[1] != 3 or not len(value):
        raise ShapeError(
            f"{name}: expected shape (N, 3) with N ≥ 1, got {value.shape}; is the model empty?"
        )
