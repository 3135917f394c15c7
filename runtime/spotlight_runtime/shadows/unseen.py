"""Says why a shadow is not seen, instead of handing over an empty picture."""

from __future__ import annotations

from typing import Final

import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.scenes.scene import Scene
from spotlight_runtime.shadows.placement import PlacedLight

__all__ = ["why_unseen"]


_LEAST: Final = 1e-3
"""Of the picture; a sliver at the object's foot guides nothing."""
_DARK: Final = 0.1
"""From here on a shadow counts as seen; also what hides the shading from the network."""
_POINTS: Final = 4_000


def why_unseen(
    shadow: FloatArray, scene: Scene, mesh: ObjectMesh, light: PlacedLight, ground: Ground | None
) -> str | None:
    """Why next to nothing of a shadow is seen.

    Parameters
    ----------
    shadow : ndarray of float32, shape (H, W)
        Already cleared under the object.
    scene : Scene
    mesh : ObjectMesh
    light : PlacedLight
    ground : Ground or None

    Returns
    -------
    str or None
        None if the shadow is seen.
    """
    if float((shadow > _DARK).mean()) >= _LEAST:
        return None
    if ground is None:
        return (
            "the shadow falls where nothing is seen to receive it; turn the light (azimuth) or "
            "raise it (elevation)"
        )
    landing = _landing(mesh.vertices[:: max(1, len(mesh.vertices) // _POINTS)], light, ground)
    if len(landing) == 0:
        return "the light is no higher than the object: no shadow reaches the floor; raise it"
    places = scene.camera.project(landing)
    behind = places[:, 2] <= 0.0
    if behind.mean() > 0.5:
        return (
            "the shadow falls behind the camera; turn the light (azimuth) or raise it (elevation)"
        )
    places = places[~behind]
    outside = {
        "to the left of": places[:, 0] < 0.0,
        "to the right of": places[:, 0] >= scene.camera.width,
        "below": places[:, 1] >= scene.camera.height,
        "above": places[:, 1] < 0.0,
    }
    missed: BoolArray = np.any(list(outside.values()), axis=0)
    if missed.mean() > 0.5:
        side = max(outside, key=lambda name: float(outside[name].mean()))
        return (
            f"the shadow falls {side} the picture; turn the light (azimuth) or raise it (elevation)"
        )
    columns, rows = places[~missed, :2].astype(np.int64).T
    if float((scene.object_mask[rows, columns] > 0.5).mean()) > 0.5:
        return "the object hides its own shadow; turn the light (azimuth) to bring it out"
    return (
        "the shadow falls on what the depth map shows as hidden from this light, or on nothing; "
        "turn the light (azimuth) or check the depth map"
    )


def _landing(vertices: FloatArray, light: PlacedLight, ground: Ground) -> FloatArray:
    """Where the light's rays through the vertices meet the floor, shape (N, 3)."""
    vertices = vertices.astype(np.float64)
    onward = -light.centre if light.directional else vertices - light.centre
    onward = np.broadcast_to(onward, vertices.shape)
    normal = np.asarray(ground.normal)
    falling = -np.einsum("vc,c->v", onward, normal)
    height = np.maximum(np.einsum("vc,c->v", vertices, normal) - ground.offset, 0.0)
    down = falling > 1e-9 * np.linalg.norm(onward, axis=1)
    return vertices[down] + onward[down] * (height[down] / falling[down])[:, None]
