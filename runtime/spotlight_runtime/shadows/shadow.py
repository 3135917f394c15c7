"""Guiding shadows: what the object's shadow would be under a light, cast on the background.

The object casts, the background receives. The object does not shadow itself: its own shading is
what the renderer guided by the shadow finds.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import GroundError, InvalidInputError, ShadowWarning
from spotlight_runtime.geometry.ground import Ground, fit_ground
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.scenes.scene import Scene
from spotlight_runtime.shadows.obstacle import Obstacle
from spotlight_runtime.shadows.occluder import Occluder, require_ray_casting
from spotlight_runtime.shadows.penumbra import SAMPLES, trace
from spotlight_runtime.shadows.placement import box_of, place_light
from spotlight_runtime.shadows.reach import reachable
from spotlight_runtime.shadows.receiver import receiver_of
from spotlight_runtime.shadows.relief import relief_mesh
from spotlight_runtime.shadows.unseen import why_unseen

__all__ = ["CastShadow", "ShadowCaster", "cast_shadow", "floor_of"]


@dataclass(frozen=True, slots=True, eq=False)
class CastShadow:
    """A guiding shadow, and what is to be said about it.

    Attributes
    ----------
    shadow : ndarray of float32, shape (H, W)
        In [0, 1]: 1 fully shadowed, 0 under the object.
    notice : str, optional
        Why (almost) nothing of it is seen, and what to do about it.
    """

    shadow: FloatArray
    notice: str | None = None


def cast_shadow(scene: Scene, light: Light, *, samples: int | None = None) -> FloatArray:
    """Cast the object's shadow on the background.

    Parameters
    ----------
    scene : Scene
        With ``object_mesh``, or else the object's depth map, from which a relief is built; and
        with the background's depth map, or else its floor, to receive the shadow.
    light : Light
    samples : int, optional
        Rays a pixel where the shadow is partial; 64 by default.

    Returns
    -------
    ndarray of float32, shape (H, W)
        In [0, 1]: 1 fully shadowed, 0 under the object.

    Warns
    -----
    ShadowWarning
        If (almost) nothing of the shadow is seen; `ShadowCaster.cast` returns the text instead.

    Raises
    ------
    LightError
        If the light stands below the floor or in the object.
    GroundError
        If the light's frame is the world's and no floor is found, or nothing receives.
    MissingExtraError
        If Embree is not installed.
    """
    result = ShadowCaster(scene).cast(light, samples=samples)
    if result.notice is not None:
        warnings.warn(result.notice, ShadowWarning, stacklevel=2)
    return result.shadow


@final
class ShadowCaster:
    """A scene made ready to cast the shadows of many lights.

    Parameters
    ----------
    scene : Scene
        As `cast_shadow` takes it.
    """

    def __init__(self, scene: Scene) -> None:
        require_ray_casting()
        self._scene = scene
        self._ground = floor_of(scene)
        receiver = receiver_of(scene, self._ground)
        if receiver is None:
            raise GroundError(
                "shadow: expected the background's depth map or a floor to receive it, the scene "
                "has neither; add one of them"
            )
        self._receiver = receiver
        self._mesh = scene.object_mesh or relief_mesh(scene, receiver, self._ground)
        self._box = box_of(self._mesh, self._ground)
        self._occluder = Occluder(self._mesh.vertices, self._mesh.faces)
        self._obstacle = Obstacle(receiver, self._box.middle)

    def cast(self, light: Light, *, samples: int | None = None) -> CastShadow:
        """Cast the shadow of one light; see `cast_shadow`."""
        if samples is not None and samples < 1:
            raise InvalidInputError(f"samples: expected at least 1, got {samples}")
        if light.frame == "world" and self._ground is None:
            raise GroundError(
                "light: expected a scene whose floor is known for a light in the world's frame; "
                "add `ground` to the scene, or give the light in the camera's frame"
            )
        placed = place_light(light, self._box, self._mesh, self._ground)
        mask = self._scene.object_mask
        pixels = reachable(self._receiver, placed, self._box, mask)
        shadow = trace(
            self._receiver, pixels, placed, self._occluder, self._obstacle, samples or SAMPLES
        )
        shadow *= np.clip(1.0 - mask, 0.0, 1.0)
        return CastShadow(shadow, why_unseen(shadow, self._scene, self._mesh, placed, self._ground))


def floor_of(scene: Scene) -> Ground | None:
    """The scene's floor: as it says, or else found in its depth; None where there is none."""
    if scene.ground is not None or scene.background_maps.depth is None:
        return scene.ground
    maps = scene.background_maps
    try:
        return fit_ground(scene.camera, scene.background_maps.depth, maps.normal)
    except GroundError:
        return None
