"""A scene: a background, an object to insert, and the intrinsic maps of both.

`Scene.load` reads two kinds of folder (or a zip of one): SpotLight's own bundle, described by
``scene.json``, and the published SpotLight/ZeroComp test-set layout
(`spotlight_runtime.scenes.testset`).
"""

from __future__ import annotations

import math
import os
import tempfile
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from spotlight_runtime.arrays import FloatArray, check_array, pad_edge
from spotlight_runtime.errors import InvalidInputError, SceneError, ShapeError
from spotlight_runtime.geometry.camera import DEFAULT_FIELD_OF_VIEW, Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.mesh import ObjectMesh

__all__ = ["MAP_NAMES", "AlbedoScale", "Intrinsics", "ObjectMesh", "Scene"]

AlbedoScale = Literal["known", "unknown"]

MAP_NAMES: Final = ("albedo", "normal", "depth", "roughness", "metallic")
_RANGES: Final = {
    "albedo": (0.0, 1.0),
    "normal": (-1.0, 1.0),
    "depth": (0.0, np.inf),
    "roughness": (0.0, 1.0),
    "metallic": (0.0, 1.0),
}
_ENOUGH_PIXELS: Final = 1 << 16
"""To tell whether a map was multiplied by the mask: one that was not says something all over."""
_NOTHING: Final = 0.01
"""Up to here; 8-bit normals have no zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """Intrinsic maps of the background, or of the object (then premultiplied by its mask).

    Attributes
    ----------
    albedo : ndarray of float32, shape (H, W, 3)
        Linear reflectance in [0, 1], as its estimator gives it.
    normal : ndarray of float32, shape (H, W, 3), optional
        Camera space in [−1, 1]: x right, y up, z towards the camera.
    depth : ndarray of float32, shape (H, W), optional
        Distance along the optical axis, ≥ 0, in one unit for background and object.
    roughness, metallic : ndarray of float32, shape (H, W), optional
        In [0, 1].
    """

    albedo: FloatArray
    normal: FloatArray | None = None
    depth: FloatArray | None = None
    roughness: FloatArray | None = None
    metallic: FloatArray | None = None

    def check(self, size: tuple[int, int], owner: str) -> None:
        """Raise unless every map has the size, dtype and range documented above."""
        for name in MAP_NAMES:
            value = getattr(self, name)
            if value is not None:
                channels = 3 if name in ("albedo", "normal") else None
                check_array(value, f"{owner} {name}", size, channels, _RANGES[name])


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything about a picture but its light.

    Attributes
    ----------
    background : ndarray of float32, shape (H, W, 3)
        Photograph without the object, linear radiance ≥ 0.
    background_maps, object_maps : Intrinsics
        Intrinsic maps; those of the object premultiplied by ``object_mask``.
    object_mask : ndarray of float32, shape (H, W)
        Coverage of the object, in [0, 1].
    footprint_depth : ndarray of float32, shape (H, W), optional
        Depth of the object's ground contact, 0 where there is none.
    truth : ndarray of float32, shape (H, W, 3), optional
        Reference picture, linear radiance.
    field_of_view : float, optional
        Horizontal, degrees.
    name : str
    albedo_scale : {"known", "unknown"}
        Whether the background's albedo is reflectance, or right up to a factor only, as other
        programs' estimates are: no picture tells bright light on dark floors from the opposite.
    object_mesh : ObjectMesh, optional
        The object as triangles in camera space, to cast shadows from.
    ground : Ground, optional
        The floor the object stands on.
    """

    background: FloatArray
    background_maps: Intrinsics
    object_maps: Intrinsics
    object_mask: FloatArray
    footprint_depth: FloatArray | None = None
    truth: FloatArray | None = None
    field_of_view: float | None = None
    name: str = "scene"
    albedo_scale: AlbedoScale = "known"
    object_mesh: ObjectMesh | None = None
    ground: Ground | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.background, np.ndarray) or self.background.ndim != 3:
            raise ShapeError("background: expected an array of shape (H, W, 3)")
        size = self.size
        check_array(self.background, "background", size, 3, (0.0, np.inf))
        check_array(self.object_mask, "object_mask", size, None, (0.0, 1.0))
        if self.object_mask.min() < 0.0 or self.object_mask.max() > 1.0:
            # By a hair, as filters leave it; then no pixel would be wholly the photograph's.
            object.__setattr__(self, "object_mask", np.clip(self.object_mask, 0.0, 1.0))
        self.background_maps.check(size, "background")
        self.object_maps.check(size, "object")
        self._check_premultiplied()
        if self.footprint_depth is not None:
            check_array(self.footprint_depth, "footprint_depth", size, None, (0.0, np.inf))
        if self.truth is not None:
            check_array(self.truth, "truth", size, 3, (0.0, np.inf))
        if self.field_of_view is not None and not 0.0 < self.field_of_view < 180.0:
            raise InvalidInputError(
                f"field_of_view: expected degrees between 0 and 180, got {self.field_of_view}"
            )

    def _check_premultiplied(self) -> None:
        """Raise where object maps go on beside the object: it would be added to the photograph's.

        Some of the edge may: rendered masks round otherwise than maps, drawn ones are harder.
        """
        every = max(1, math.isqrt(self.object_mask.size // _ENOUGH_PIXELS))
        some = np.s_[::every, ::every]
        beside = self.object_mask[some] == 0.0
        for name in MAP_NAMES:
            value = getattr(self.object_maps, name)
            if value is None:
                continue
            said = np.abs(value[some]).reshape(*beside.shape, -1).max(axis=2)
            astray = beside & (said > _NOTHING * max(1.0, said.max()))
            if 2 * np.count_nonzero(astray) > np.count_nonzero(beside):
                raise InvalidInputError(
                    f"object {name}: expected 0 where object_mask is 0, got up to "
                    f"{said[astray].max():.3g}; multiply the map by the mask"
                )

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.background.shape[0], self.background.shape[1]

    @property
    def camera(self) -> Camera:
        """The camera; 50 degrees wide where the scene does not say."""
        height, width = self.size
        return Camera(width, height, self.field_of_view or DEFAULT_FIELD_OF_VIEW)

    def has_map(self, name: str) -> bool:
        """Whether background and object both have the map."""
        return all(
            getattr(maps, name) is not None for maps in (self.background_maps, self.object_maps)
        )

    def padded(self, multiple: int) -> Scene:
        """The scene grown to the right and below to multiples, by repeating its border.

        The grown scene has no geometry: its optical axis is not in its middle any more.
        """
        height, width = (-(-side // multiple) * multiple for side in self.size)
        if (height, width) == self.size:
            return self

        def grow(array: FloatArray | None) -> FloatArray | None:
            return None if array is None else pad_edge(array, (height, width))

        def grow_maps(maps: Intrinsics) -> Intrinsics:
            grown: dict[str, Any] = {name: grow(getattr(maps, name)) for name in MAP_NAMES}
            return replace(maps, **grown)

        return replace(
            self,
            background=pad_edge(self.background, (height, width)),
            background_maps=grow_maps(self.background_maps),
            object_maps=grow_maps(self.object_maps),
            object_mask=pad_edge(self.object_mask, (height, width)),
            footprint_depth=grow(self.footprint_depth),
            truth=grow(self.truth),
            object_mesh=None,
            ground=None,
        )

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene folder, or a zip of one.

        Raises
        ------
        SceneError
            If there is no scene, ``scene.json`` is malformed, or (`UnsafePathError`) a file it
            names lies outside the bundle.
        ImageFileError
            If one of its images cannot be read.
        InvalidInputError
            If a map has the wrong size, channels or range, or holds NaN.
        """
        path = Path(path)
        # The readers build scenes, so they know this module and it meets them only here.
        from spotlight_runtime.scenes.archive import unpack
        from spotlight_runtime.scenes.bundle import SCENE_FILE, load_bundle
        from spotlight_runtime.scenes.testset import bundle_file, load_published

        if _is_zip(path):
            with tempfile.TemporaryDirectory(prefix="spotlight-scene-") as folder:
                # Errors then name the archive, not only a folder that is gone.
                return cls.load(unpack(path, Path(folder) / path.name))
        if os.path.isfile(path / SCENE_FILE):  # unlike Path.is_file, False for impossible names
            return load_bundle(path)
        if bundle_file(path) is not None:
            return load_published(path)
        raise SceneError(
            f"{path}: no scene here; expected a folder or zip with {SCENE_FILE}, or a published "
            "scene with <name>_bundle0001.exr"
        )

    def save(self, folder: str | Path) -> None:
        """Write the scene as a bundle: PNG (16 bit) for maps in [0, 1], EXR for the others.

        ``scene.json`` is written last, so an interrupted save is not taken for a scene.

        Raises
        ------
        SceneError
            If ``folder`` is a file.
        ImageFileError
            If a map cannot be written.
        """
        from spotlight_runtime.scenes.bundle import save_bundle

        save_bundle(self, Path(folder))


def _is_zip(path: Path) -> bool:
    """Whether a file is an archive, however damaged."""
    try:
        return os.path.isfile(path) and zipfile.is_zipfile(path)
    except zipfile.BadZipFile:  # of a directory that says it lies on several disks
        return True
