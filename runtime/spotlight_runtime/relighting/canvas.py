"""What the photograph's own scale adds to a picture that is diffused at the model's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.scenes.scene import Scene

__all__ = ["Canvas"]


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """The part of a scene that pictures are put back on.

    A scene of twelve megapixels takes a gigabyte, most of it maps that have served when the window
    is prepared. Who lets go of the scene and keeps the canvas gets half of that back.

    Attributes
    ----------
    background : ndarray of float32, shape (H, W, 3)
        Linear radiance ≥ 0.
    mask : ndarray of float32, shape (H, W)
        Coverage of the object.
    albedo : ndarray of float32, shape (H, W, 3)
        Of the object, premultiplied.
    normal : ndarray of float32, shape (H, W, 3 or 0)
        Likewise; no channels where the object has none.
    """

    background: FloatArray
    mask: FloatArray
    albedo: FloatArray
    normal: FloatArray

    @classmethod
    def of(cls, scene: Scene) -> Canvas:
        """The canvas of a scene; its arrays, not copies."""
        maps = scene.object_maps
        normal = np.zeros((*scene.size, 0), np.float32) if maps.normal is None else maps.normal
        return cls(scene.background, scene.object_mask, maps.albedo, normal)

    def crop(self, size: tuple[int, int]) -> Canvas:
        """The upper left part, of this height and width."""
        corner = np.s_[: size[0], : size[1]]
        return Canvas(
            self.background[corner], self.mask[corner], self.albedo[corner], self.normal[corner]
        )

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.mask.shape[0], self.mask.shape[1]
