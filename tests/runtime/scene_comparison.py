"""Scenes compared map by map."""

import numpy as np

from spotlight_runtime import Scene
from spotlight_runtime.scenes.scene import MAP_NAMES


def arrays_of(scene: Scene) -> dict[str, np.ndarray]:
    """Every array a scene holds, by a name people know it by."""
    arrays = {
        "background": scene.background,
        "object_mask": scene.object_mask,
        "footprint_depth": scene.footprint_depth,
        "truth": scene.truth,
    }
    for owner in ("background", "object"):
        maps = getattr(scene, f"{owner}_maps")
        arrays |= {f"{owner} {name}": getattr(maps, name) for name in MAP_NAMES}
    return {name: array for name, array in arrays.items() if array is not None}


def assert_same_scene(got: Scene, wanted: Scene, atol: float = 0.0) -> None:
    """Same maps with the same values."""
    got_arrays, wanted_arrays = arrays_of(got), arrays_of(wanted)
    assert got_arrays.keys() == wanted_arrays.keys()
    for name, array in wanted_arrays.items():
        np.testing.assert_allclose(got_arrays[name], array, atol=atol, err_msg=name)
