"""One rendered scene on disk.

A zip of PNG images and the scene's JSON, readable with any picture viewer.

Zip of PNG, because the maps are 8- and 16-bit images that PNG's predictors pack three times tighter
than plain deflate, decode at memory speed, and can be looked at without this program. The zip
itself only stores.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spotlight_spec import replacing

from . import codec
from .description import SceneDescription
from .mesh import Array

SUFFIX = ".scene.zip"
_DESCRIPTION = "description.json"


@dataclass(frozen=True)
class MapSet:
    """Maps of one layer, float32, at full resolution.

    For the background every pixel is defined: where the sky shows, `alpha` is 0, albedo 1, the
    normal faces the camera and depth is 20 m. For the object the values are those of the object's
    own samples (not premultiplied) and 0 where `alpha` is 0.

    Attributes
    ----------
    albedo : array, shape (H, W, 3), linear, in [0, 1]
    normal : array, shape (H, W, 3)
        Camera space: x right, y up, z towards the camera; unit length.
    depth : array, shape (H, W)
        Along the optical axis, metres.
    roughness, metallic, alpha : array, shape (H, W), in [0, 1]
    """

    albedo: Array
    normal: Array
    depth: Array
    roughness: Array
    metallic: Array
    alpha: Array


@dataclass(frozen=True)
class SceneRecord:
    """Everything rendered of one scene; all arrays float32.

    Attributes
    ----------
    description : SceneDescription
    background, object : MapSet
    footprint_depth : array, shape (H, W)
        Depth in metres of the support where the object touches it, 0 elsewhere.
    lights, lights_background : mapping of str to array, shape (H, W, 3)
        Linear radiance under each dominant light alone, with the object and without it, by the
        light's name.
    ambient, ambient_background : array, shape (H, W, 3)
        The same under the ambient light.
    shadows : mapping of str to array, shape (H, W), in [0, 1]
        Share of each light's direct irradiance on the background geometry that the object takes
        away. The object itself is not seen and not shadowed; 0 where the light does not reach
        anyway.
    """

    description: SceneDescription
    background: MapSet
    object: MapSet
    footprint_depth: Array
    lights: Mapping[str, Array]
    lights_background: Mapping[str, Array]
    ambient: Array
    ambient_background: Array
    shadows: Mapping[str, Array]

    def radiance(
        self,
        weights: Mapping[str, float | tuple[float, float, float]],
        ambient: float | tuple[float, float, float] | None = None,
        with_object: bool = True,
    ) -> Array:
        """Add up lightings: linear radiance, shape (H, W, 3).

        Parameters
        ----------
        weights : mapping of str to number or RGB
            Strength of each dominant light by name; lights left out are off.
        ambient : number or RGB, optional
            Strength of the ambient light; the scene's own suggestion if not given.
        with_object : bool
            False gives the background alone.

        Raises
        ------
        KeyError
            If the scene has no light of a given name.
        """
        lights, base = (
            (self.lights, self.ambient)
            if with_object
            else (self.lights_background, self.ambient_background)
        )
        unknown = sorted(set(weights) - set(lights))
        if unknown:
            raise KeyError(
                f"light weights: this scene has the lights {', '.join(sorted(lights))}; "
                f"got {', '.join(unknown)}."
            )
        strength = self.description.ambient.weight if ambient is None else ambient
        total = base * np.asarray(strength, dtype=np.float32)
        for name, weight in weights.items():
            total = total + lights[name] * np.asarray(weight, dtype=np.float32)
        return total

    def exposure(
        self,
        weights: Mapping[str, float | tuple[float, float, float]],
        ambient: float | tuple[float, float, float] | None = None,
        white: float = 0.9,
    ) -> float:
        """Return the factor, in [0.25, 4], that brings the background's 95th percentile to `white`.

        Taken from the background alone, so that the pictures with and without the object share it.
        """
        bright = float(
            np.percentile(self.radiance(weights, ambient, with_object=False).max(axis=2), 95)
        )
        return float(np.clip(white / max(bright, 1e-6), 0.25, 4.0))

    def image(
        self,
        weights: Mapping[str, float | tuple[float, float, float]],
        ambient: float | tuple[float, float, float] | None = None,
        exposure: float | None = None,
        with_object: bool = True,
    ) -> Array:
        """Return a lighting as a gamma-2.2 encoded image in [0, 1], shape (H, W, 3).

        See `radiance` and `exposure`.
        """
        factor = self.exposure(weights, ambient) if exposure is None else exposure
        return codec.encode_image(self.radiance(weights, ambient, with_object) * np.float32(factor))

    def composed(self) -> MapSet:
        """Return the object's maps laid over the background's by its alpha.

        Normals are renormalised.
        """
        back, front = self.background, self.object
        share = front.alpha[..., None]
        normal = front.normal * share + back.normal * (1 - share)
        return MapSet(
            albedo=front.albedo * share + back.albedo * (1 - share),
            normal=normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-6),
            depth=front.depth * front.alpha + back.depth * (1 - front.alpha),
            roughness=front.roughness * front.alpha + back.roughness * (1 - front.alpha),
            metallic=front.metallic * front.alpha + back.metallic * (1 - front.alpha),
            alpha=np.maximum(front.alpha, back.alpha),
        )

    def save(self, path: Path) -> None:
        """Write the record beside its final name, then rename: a file that exists is whole."""
        members = {
            **_map_members("background", self.background),
            **_map_members("object", self.object),
        }
        members["footprint_depth"] = codec.to_png(codec.encode_depth(self.footprint_depth))
        images = {"ambient": self.ambient, "ambient_background": self.ambient_background}
        images |= {f"light_{name}": image for name, image in self.lights.items()}
        images |= {
            f"light_{name}_background": image for name, image in self.lights_background.items()
        }
        members |= {
            name: codec.to_png(codec.encode_radiance(image)) for name, image in images.items()
        }
        members |= {
            f"shadow_{name}": codec.to_png(codec.encode_unit(s)) for name, s in self.shadows.items()
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as file:
            # A fixed date, so that equal content gives equal bytes.
            file.writestr(zipfile.ZipInfo(_DESCRIPTION), self.description.to_json())
            for name, data in members.items():
                file.writestr(zipfile.ZipInfo(f"{name}.png"), data)

    @staticmethod
    def load(path: Path | str) -> SceneRecord:
        """Read a record.

        Raises
        ------
        FileNotFoundError
            If there is none at the path.
        ValueError
            If the file is damaged or of another format version.
        """
        if not Path(path).exists():
            raise FileNotFoundError(
                f"scene record: expected a file at {path}, found none. "
                "Render it with 'spotlight-train render'."
            )
        try:
            with zipfile.ZipFile(path) as file:
                members = {info.filename: file.read(info) for info in file.infolist()}
        except zipfile.BadZipFile as error:
            raise ValueError(
                f"scene record: {path} is not a whole record ({error}). "
                "Delete it and render its scene again."
            ) from error
        description = SceneDescription.from_json(members[_DESCRIPTION].decode())
        image = {
            name.removesuffix(".png"): data
            for name, data in members.items()
            if name.endswith(".png")
        }

        def radiance(name: str) -> Array:
            return codec.decode_radiance(codec.from_png(image[name]))

        names = [light.name for light in description.lights]
        return SceneRecord(
            description=description,
            background=_read_maps(image, "background"),
            object=_read_maps(image, "object"),
            footprint_depth=codec.decode_depth(codec.from_png(image["footprint_depth"])),
            lights={name: radiance(f"light_{name}") for name in names},
            lights_background={name: radiance(f"light_{name}_background") for name in names},
            ambient=radiance("ambient"),
            ambient_background=radiance("ambient_background"),
            shadows={
                name: codec.decode_unit(codec.from_png(image[f"shadow_{name}"])) for name in names
            },
        )


def record_path(folder: Path, split: str, seed: int) -> Path:
    """Return where a scene's record lies: `folder/split/000123.scene.zip`."""
    return folder / split / f"{seed:06d}{SUFFIX}"


def is_whole(path: Path) -> bool:
    """Say whether a record exists and its zip directory can be read."""
    return path.exists() and zipfile.is_zipfile(path)


def _map_members(layer: str, maps: MapSet) -> dict[str, bytes]:
    surface = np.stack([maps.roughness, maps.metallic, maps.alpha], axis=-1)
    return {
        f"{layer}_albedo": codec.to_png(codec.encode_albedo(maps.albedo)),
        f"{layer}_normal": codec.to_png(codec.encode_normal(maps.normal)),
        f"{layer}_depth": codec.to_png(codec.encode_depth(maps.depth)),
        f"{layer}_roughness_metallic_alpha": codec.to_png(codec.encode_unit(surface)),
    }


def _read_maps(image: Mapping[str, bytes], layer: str) -> MapSet:
    surface = codec.decode_unit(codec.from_png(image[f"{layer}_roughness_metallic_alpha"]))
    normal = codec.decode_normal(codec.from_png(image[f"{layer}_normal"]))
    if layer == "object":
        normal = normal * (surface[..., 2:] > 0)
    return MapSet(
        albedo=codec.decode_albedo(codec.from_png(image[f"{layer}_albedo"])),
        normal=normal,
        depth=codec.decode_depth(codec.from_png(image[f"{layer}_depth"])),
        roughness=np.ascontiguousarray(surface[..., 0]),
        metallic=np.ascontiguousarray(surface[..., 1]),
        alpha=np.ascontiguousarray(surface[..., 2]),
    )
