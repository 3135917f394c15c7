"""What the shadow falls on: the background's surface as its depth map shows it, pixel by pixel.

Each pixel carries its own small plane, so nothing is stretched between the sides of an edge in
depth, and points between pixel centres lie on the surface, not beside it. Along a plane 1/depth is
linear in the picture; that is why it is what is stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.scenes.scene import Scene

__all__ = ["Patch", "Receiver", "receiver_of"]


FAR: Final = 20.0
"""Depth maps of this method are cut off here, in metres; what lies at the cut is sky."""

_NEAREST: Final = 1e-6
"""Nothing is seen from nearer, whatever the unit; 1/depth of less may be no float32."""
_AT_THE_CUT: Final = 1.0 - 1e-3
_STEEPEST: Final = 0.25
"""Relative change of 1/depth in a pixel beyond which it is an edge, not a surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Some pixels of a receiver, flat.

    Attributes
    ----------
    rays, normals : ndarray of float32, shape (P, 3)
        Camera space; rays with z = −1.
    inverse_depth, across, down : ndarray of float32, shape (P,)
        1/depth at the pixel's centre, and its change by one pixel to the right and down.
    pixel : float
        Side of a pixel at depth 1.
    """

    rays: FloatArray
    normals: FloatArray
    inverse_depth: FloatArray
    across: FloatArray
    down: FloatArray
    pixel: float

    def points(self, dx: float = 0.0, dy: float = 0.0) -> FloatArray:
        """Points beside the pixels' centres, shape (P, 3), camera space.

        Parameters
        ----------
        dx, dy : float
            Pixels to the right and down, in [−0.5, 0.5].
        """
        depth = 1.0 / (self.inverse_depth + dx * self.across + dy * self.down)
        points = self.rays * depth[:, None]
        points[:, 0] += np.float32(dx * self.pixel) * depth
        points[:, 1] -= np.float32(dy * self.pixel) * depth
        return points

    def take(self, rows: npt.NDArray[Any]) -> Patch:
        """Some of the pixels, by index or mask."""
        return Patch(
            self.rays[rows],
            self.normals[rows],
            self.inverse_depth[rows],
            self.across[rows],
            self.down[rows],
            self.pixel,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Receiver:
    """The background's surface.

    Attributes
    ----------
    camera : Camera
    inverse_depth : ndarray of float32, shape (H, W)
        0 where nothing can receive a shadow: unknown depth, sky, above the horizon.
    normal : ndarray of float32, shape (H, W, 3), optional
        Camera space, unit length; taken from the depth where it is not given.
    """

    camera: Camera
    inverse_depth: FloatArray
    normal: FloatArray | None = None

    def patch(self, pixels: npt.NDArray[np.int64]) -> Patch:
        """The pixels of the given flat indices, shape (P,)."""
        rows, columns = np.divmod(pixels, self.camera.width)
        focal = np.float32(self.camera.focal)
        rays = np.empty((len(pixels), 3), dtype=np.float32)
        rays[:, 0] = (columns + 0.5 - 0.5 * self.camera.width) / focal
        rays[:, 1] = (0.5 * self.camera.height - rows - 0.5) / focal
        rays[:, 2] = -1.0
        w = self.inverse_depth[rows, columns]
        across, down = self._slope(rows, columns, 1), self._slope(rows, columns, 0)
        if self.normal is None:
            # n·ray = offset·w, so n / offset is the gradient of w over the ray's x and y.
            normals = np.stack([across * focal, -down * focal, np.zeros_like(w)], axis=1)
            normals[:, 2] = np.einsum("pc,pc->p", normals, rays) - w
            normals *= np.where(normals[:, 2:] < 0.0, np.float32(-1.0), np.float32(1.0))
        else:
            normals = self.normal[rows, columns]
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
        return Patch(rays, normals, w, across, down, 1.0 / self.camera.focal)

    def _slope(
        self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64], axis: int
    ) -> FloatArray:
        """Change of 1/depth by one pixel: the smaller of both sides, none across an edge."""
        w, size = self.inverse_depth, self.inverse_depth.shape[axis]
        along, stride = (rows, w.shape[1]) if axis == 0 else (columns, 1)
        flat, index = w.ravel(), rows * w.shape[1] + columns
        here = flat[index]
        first, last = along == 0, along == size - 1
        back = here - flat[index - np.where(first, 0, stride)]
        ahead = flat[index + np.where(last, 0, stride)] - here
        back, ahead = np.where(first, ahead, back), np.where(last, back, ahead)
        slope = np.where(np.abs(ahead) <= np.abs(back), ahead, back)
        return np.asarray(np.where(np.abs(slope) <= _STEEPEST * here, slope, 0.0), np.float32)


def receiver_of(scene: Scene, ground: Ground | None) -> Receiver | None:
    """The background's surface, from its depth map, or else the floor.

    Returns
    -------
    Receiver or None
        None if the scene has neither depth nor a floor.
    """
    depth = scene.background_maps.depth
    if depth is None:
        if ground is None:
            return None
        rising = scene.camera.rays() @ np.asarray(ground.normal, dtype=np.float32)
        inverse = np.maximum(rising / np.float32(ground.offset), 0.0)
        return Receiver(scene.camera, inverse.astype(np.float32), _constant(inverse, ground))
    farthest = float(depth.max())
    seen = depth > _NEAREST
    if farthest >= FAR * _AT_THE_CUT:
        seen &= depth < farthest * _AT_THE_CUT
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=seen)
    return Receiver(scene.camera, inverse, scene.background_maps.normal)


def _constant(like: FloatArray, ground: Ground) -> FloatArray:
    return np.broadcast_to(np.array(ground.normal, dtype=np.float32), (*like.shape, 3))
