"""Loaded scenes, the least recently used let go first, bounded in bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import numpy as np

from spotlight_runtime import Scene
from spotlight_runtime.scenes.scene import MAP_NAMES

__all__ = ["SceneCache", "scene_bytes"]


class SceneCache:
    """Scenes by id; for one thread.

    Parameters
    ----------
    capacity : int
        Bytes to hold at most. A scene that is larger alone is loaded and not held.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._held: OrderedDict[str, tuple[Scene, int]] = OrderedDict()
        self.hits = self.misses = 0

    @property
    def bytes(self) -> int:
        """How much is held."""
        return sum(size for _, size in self._held.values())

    def get(self, key: str, load: Callable[[], Scene]) -> Scene:
        """The scene of that key, loaded where it is not held."""
        if key in self._held:
            self.hits += 1
            self._held.move_to_end(key)
            return self._held[key][0]
        self.misses += 1
        scene = load()
        size = scene_bytes(scene)
        if size <= self._capacity:
            self._held[key] = (scene, size)
            while self.bytes > self._capacity:
                self._held.popitem(last=False)
        return scene

    def load(self, key: str, folder: Path) -> Scene:
        """The scene in a folder."""
        return self.get(key, lambda: Scene.load(folder))


def scene_bytes(scene: Scene) -> int:
    """Bytes of a scene's arrays."""
    maps = [getattr(m, n) for m in (scene.background_maps, scene.object_maps) for n in MAP_NAMES]
    mesh = scene.object_mesh
    arrays = [
        *(scene.background, scene.object_mask, scene.footprint_depth, scene.truth, *maps),
        *(() if mesh is None else (mesh.vertices, mesh.faces)),
    ]
    return sum(np.asarray(array).nbytes for array in arrays if array is not None)
