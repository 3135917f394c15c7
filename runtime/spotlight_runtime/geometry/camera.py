"""A pinhole camera: from pixels and depth to points and back.

Camera space has x to the right, y up and z towards the camera, which stands in the origin and looks
down −z. Depth is the distance along the optical axis, positive. Pixel centres lie at +0.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import InvalidInputError

__all__ = ["DEFAULT_FIELD_OF_VIEW", "Camera"]


DEFAULT_FIELD_OF_VIEW: Final = 50.0
"""Degrees; what the published test set was rendered with."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera with square pixels and its principal point in the middle.

    Attributes
    ----------
    width, height : int
        Of the image, in pixels.
    field_of_view : float
        Horizontal, degrees.
    """

    width: int
    height: int
    field_of_view: float = DEFAULT_FIELD_OF_VIEW

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InvalidInputError(
                f"camera: expected an image of at least one pixel, got {self.width}×{self.height}"
            )
        if not 0.0 < self.field_of_view < 180.0:
            raise InvalidInputError(
                f"field_of_view: expected degrees between 0 and 180, got {self.field_of_view}"
            )

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.width / math.tan(math.radians(self.field_of_view) / 2)

    def rays(self) -> FloatArray:
        """Directions through the pixel centres, scaled to reach depth 1.

        Returns
        -------
        ndarray of float32, shape (H, W, 3)
            With z = −1.
        """
        rays = np.empty((self.height, self.width, 3), dtype=np.float32)
        rays[..., 0] = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal
        rays[..., 1] = (0.5 * self.height - np.arange(self.height) - 0.5)[:, None] / self.focal
        rays[..., 2] = -1.0
        return rays

    def unproject(self, depth: FloatArray) -> FloatArray:
        """Points seen by the pixels.

        Parameters
        ----------
        depth : ndarray of float32, shape (H, W)

        Returns
        -------
        ndarray of float32, shape (H, W, 3)
            Camera space, in the unit of the depth.
        """
        return self.rays() * depth[..., None]

    def project(self, points: FloatArray) -> FloatArray:
        """Where points appear.

        Parameters
        ----------
        points : ndarray of float, shape (N, 3)
            Camera space.

        Returns
        -------
        ndarray of float, shape (N, 3)
            x and y in pixels (right and down from the upper left corner), and depth. What lies
            behind the camera has a negative depth, and an x and y without meaning.
        """
        depth = -points[:, 2]
        nonzero = np.where(depth == 0.0, np.finfo(points.dtype).tiny, depth)
        with np.errstate(over="ignore"):
            x = 0.5 * self.width + self.focal * points[:, 0] / nonzero
            y = 0.5 * self.height - self.focal * points[:, 1] / nonzero
        return np.stack([x, y, depth], axis=1)
