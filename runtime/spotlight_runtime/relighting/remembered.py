"""Pictures without shadow that were made before: one a scene and seed serves all its lights."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from threading import Lock
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.scenes.scene import MAP_NAMES, Scene

__all__ = ["CAPACITY", "Remembered", "plain_key", "view_digest"]

CAPACITY: Final = 64 * 2**20
"""Bytes: eighty pictures of 256 pixels, twenty of 512."""


class Remembered:
    """Pictures by key, the least recently used let go first; safe to share between threads.

    Parameters
    ----------
    capacity : int
        Bytes to hold at most; 0 remembers nothing.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._pictures: OrderedDict[str, FloatArray] = OrderedDict()
        self._lock = Lock()

    @property
    def bytes(self) -> int:
        """How much is held."""
        with self._lock:
            return sum(picture.nbytes for picture in self._pictures.values())

    def get(self, key: str) -> FloatArray | None:
        """The picture of that key, read-only; None where it is not known."""
        with self._lock:
            if key in self._pictures:
                self._pictures.move_to_end(key)
            return self._pictures.get(key)

    def put(self, key: str, picture: FloatArray) -> None:
        """Remember a picture, and forget the oldest where there are too many."""
        kept = picture.copy()
        kept.setflags(write=False)
        with self._lock:
            self._pictures[key] = kept
            self._pictures.move_to_end(key)
            held = sum(each.nbytes for each in self._pictures.values())
            while held > self._capacity:
                _, gone = self._pictures.popitem(last=False)
                held -= gone.nbytes


def view_digest(view: Scene) -> str:
    """Digest of all the picture without shadow shows; equal views have equal ones."""
    digest = hashlib.sha256(repr(view.size).encode())
    both = (view.background_maps, view.object_maps)
    maps = [getattr(maps, name) for maps in both for name in MAP_NAMES]
    for array in (view.background, view.object_mask, view.footprint_depth, *maps):
        digest.update(b"-" if array is None else np.ascontiguousarray(array).data)
    return digest.hexdigest()


def plain_key(view: str, options: RelightOptions, denoised: str) -> str:
    """Name of all that the picture without shadow depends on: view, noise, steps, denoiser.

    Parameters
    ----------
    view : str
        Digest of what is diffused.
    options : RelightOptions
        With numbers of steps.
    denoised : str
    """
    said = (view, options.seed, options.solver, options.plain_steps, options.reuse, denoised)
    return repr(said)
