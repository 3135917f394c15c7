"""The part of a photograph that is diffused, and how it looks at the model's scale.

A renderer trained on 256 or 512 pixels is asked about that many, whatever the photograph has: a
window around the object and its shadows, shrunk where it is larger. The result is put back at the
photograph's resolution by `spotlight_runtime.relighting.putback`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.diffusion.conditioning import SHADOW_THRESHOLD
from spotlight_runtime.planning.options import WindowMode
from spotlight_runtime.scenes.scene import MAP_NAMES, Intrinsics, Scene

__all__ = ["Window", "choose_window", "look", "shrink"]

LARGEST_OBJECT: Final = 0.55
"""Share of the window's side that the object takes at most: what renderers are trained on."""
MARGIN: Final = 0.1
"""Context on each side of object and shadows together, as a share of their longer side."""
ENOUGH_CONTACT: Final = 0.5
"""A shrunken pixel touches the ground where at least this share of it does."""
COARSE: Final = 5 / 8
"""Of the backbone's own side, what a coarse window is diffused at. Two or three steps so are nearer
to the truth than four at half the side, in less time."""
SHORTEST_NORMAL: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of the photograph, and its size at the model's scale.

    Attributes
    ----------
    top, left, height, width : int
        In pixels of the photograph.
    size : tuple of int
        Height and width it is diffused at; never more than it has.
    frame : tuple of int
        Height and width of the photograph.
    """

    top: int
    left: int
    height: int
    width: int
    size: tuple[int, int]
    frame: tuple[int, int]

    @classmethod
    def whole(cls, frame: tuple[int, int]) -> Window:
        """The whole photograph at its own scale."""
        return cls(0, 0, *frame, size=frame, frame=frame)

    @property
    def native(self) -> bool:
        """Whether this is the whole photograph at its own scale."""
        return self.size == self.frame

    @property
    def scale(self) -> float:
        """Pixels of the photograph per pixel of the model, at least 1."""
        return math.sqrt(self.height * self.width / (self.size[0] * self.size[1]))

    def crop(self, array: FloatArray) -> FloatArray:
        """The window's part of an array of shape (H, W) or (H, W, C); a view."""
        rows = slice(self.top, self.top + self.height)
        return array[rows, self.left : self.left + self.width]


def choose_window(
    size: int,
    multiple: int,
    object_mask: FloatArray,
    shadows: Sequence[FloatArray],
    mode: WindowMode = "auto",
) -> Window:
    """Choose what is diffused.

    Parameters
    ----------
    size : int
        Side in pixels of the square the backbone was trained at.
    multiple : int
        Sides at the model's scale are multiples of this where the photograph allows it.
    object_mask : ndarray of float32, shape (H, W)
    shadows : sequence of ndarray of float32, shape (H, W)
        All guiding shadows, positive and negative, that this window is to serve.
    mode : {"auto", "frame", "tight", "coarse"}
        ``frame``: the whole photograph at its own scale, whatever that costs. ``tight``: no more
        than is needed, of a small photograph too. ``coarse``: the same, at `COARSE` of ``size``.

    Returns
    -------
    Window
        The whole photograph where it has no more pixels than the backbone was trained at (unless
        it is to be tight), or where there is neither object nor shadow and so nothing to look
        closer at. Otherwise a square around object, shadows and a margin; less than square where
        the photograph ends.
    """
    height, width = object_mask.shape
    frame = (height, width)
    tight = mode in ("tight", "coarse")
    if mode == "coarse":
        size = round(COARSE * size)
    if mode == "frame" or (height * width <= size * size and not tight):
        return Window.whole(frame)
    inserted = _box(object_mask > 0.0)
    boxes = [inserted, *(_box(shadow > SHADOW_THRESHOLD) for shadow in shadows)]
    there = [box for box in boxes if box is not None]
    if not there:
        return _fitted(0, 0, height, width, frame, size, multiple)
    lows, highs = np.array(there)[:, :2].min(axis=0), np.array(there)[:, 2:].max(axis=0)
    needed = (1.0 + 2.0 * MARGIN) * float((highs - lows).max())
    if inserted is not None:
        needed = max(needed, max(np.subtract(inserted[2:], inserted[:2])) / LARGEST_OBJECT)
    side = math.ceil(needed / multiple) * multiple if tight else max(size, math.ceil(needed))
    high, wide = min(side, height), min(side, width)
    middle = (lows + highs) // 2
    top, left = _placed(int(middle[0]), high, height), _placed(int(middle[1]), wide, width)
    return _fitted(top, left, high, wide, frame, size, multiple)


def look(scene: Scene, window: Window) -> Scene:
    """The window's part of a scene, at the model's scale.

    Parameters
    ----------
    scene : Scene
    window : Window

    Returns
    -------
    Scene
        Antialiased maps: premultiplied ones stay so, normals keep their length, contact depths
        are averaged where there is contact. Without truth, camera and geometry, which are those
        of the whole photograph.
    """
    if window.native:
        return scene
    mask = shrink(window.crop(scene.object_mask), window.size)
    foot = scene.footprint_depth
    return replace(
        scene,
        background=shrink(window.crop(scene.background), window.size),
        background_maps=_shrink_maps(scene.background_maps, window, None),
        object_maps=_shrink_maps(scene.object_maps, window, mask),
        object_mask=mask,
        footprint_depth=None if foot is None else _shrink_contact(window.crop(foot), window.size),
        truth=None,
        field_of_view=None,
        object_mesh=None,
        ground=None,
    )


def shrink(array: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Antialiased downsampling of an array of shape (H, W) or (H, W, C) to ``size``: area means."""
    if array.shape[:2] == size:
        return np.ascontiguousarray(array)
    small = cv2.resize(array, size[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def _shrink_maps(maps: Intrinsics, window: Window, mask: FloatArray | None) -> Intrinsics:
    """All maps of the background, or of the object if its (shrunken) mask is given."""
    small: dict[str, Any] = {}
    for name in MAP_NAMES:
        value = getattr(maps, name)
        if value is not None:
            small[name] = shrink(window.crop(value), window.size)
    if "normal" in small:
        small["normal"] = _renormalised(small["normal"], mask)
    return replace(maps, **small)


def _renormalised(normal: FloatArray, mask: FloatArray | None) -> FloatArray:
    """Give averaged normals the length they had: one, times the mask if premultiplied."""
    length = np.sqrt(np.einsum("hwc,hwc->hw", normal, normal))
    wanted = np.ones_like(length) if mask is None else mask
    usable = length > SHORTEST_NORMAL
    factor = np.divide(wanted, length, out=np.zeros_like(length), where=usable)
    return normal * factor[..., None]


def _shrink_contact(depth: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Mean contact depth where enough of a pixel touches; a thinner contact is kept whole."""
    touching = shrink((depth > 0.0).astype(np.float32), size)
    enough = touching >= ENOUGH_CONTACT
    if not enough.any():
        enough = touching > 0.0
    return np.divide(shrink(depth, size), touching, out=np.zeros_like(touching), where=enough)


def _box(covered: BoolArray) -> tuple[int, int, int, int] | None:
    """Top, left, bottom and right of what is covered; None where nothing is."""
    rows, columns = (np.flatnonzero(covered.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return None
    return int(rows[0]), int(columns[0]), int(rows[-1]) + 1, int(columns[-1]) + 1


def _placed(centre: int, length: int, limit: int) -> int:
    """Where a stretch of this length around the centre begins, inside [0, limit]."""
    return min(max(centre - length // 2, 0), limit - length)


def _fitted(
    top: int,
    left: int,
    height: int,
    width: int,
    frame: tuple[int, int],
    size: int,
    multiple: int,
) -> Window:
    """Shrink a window to the pixels the backbone was trained at; never enlarge it."""
    factor = min(1.0, size / math.sqrt(height * width))
    if factor == 1.0:
        return Window(top, left, height, width, (height, width), frame)

    def side(length: int) -> int:
        return min(length, max(multiple, round(length * factor / multiple) * multiple))

    return Window(top, left, height, width, (side(height), side(width)), frame)
