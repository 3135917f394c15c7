"""What is in a scene, as plain data: everything the renderer needs, and nothing of the renderer.

World frame: the inserted object stands over the origin of the floor plane, x points to the camera's
right, y away from the camera, z up; metres and degrees. The camera never rolls and its viewing
direction projects onto +y, so that a light's azimuth (0 = camera right, 90 = away from the camera)
is the angle in the world's x-y plane.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

FORMAT_VERSION = 1

Colour = tuple[float, float, float]
"""Linear RGB."""


@dataclass(frozen=True)
class Material:
    """A procedural surface.

    Three colours mixed by a pattern, one roughness (modulated by it), one metalness.
    """

    pattern: str
    seed: int
    colours: tuple[Colour, Colour, Colour]
    period: float
    """Metres that one repeat covers."""
    roughness: float
    metallic: float


@dataclass(frozen=True)
class Item:
    """An object: a generator kind (or `file:NAME`), its seed, and where it stands."""

    kind: str
    seed: int
    size: float
    """Metres along the longest side of its bounding box."""
    yaw: float
    position: tuple[float, float, float]
    """Of the centre of its underside."""
    materials: tuple[Material, ...]


@dataclass(frozen=True)
class Panel:
    """A flat box: a rug, a picture, a plinth or a skirting board.

    `size` is its extent before `yaw` about z.
    """

    position: tuple[float, float, float]
    """Of its centre."""
    size: tuple[float, float, float]
    yaw: float
    material: Material


@dataclass(frozen=True)
class Wall:
    """A vertical wall `distance` metres from the origin towards `azimuth`, facing it."""

    azimuth: float
    distance: float
    height: float
    material: Material


@dataclass(frozen=True)
class Camera:
    """A square pinhole camera; `pitch` is how far it looks down."""

    position: tuple[float, float, float]
    pitch: float
    fov: float


@dataclass(frozen=True)
class Light:
    """A spherical light seen from the middle of the object.

    Its radiance is set so that a white diffuse surface at the object, facing it, reflects radiance
    `colour`.
    """

    name: str
    azimuth: float
    elevation: float
    distance: float
    radius: float
    colour: Colour
    position: tuple[float, float, float]


@dataclass(frozen=True)
class Ambient:
    """Light from all round.

    An HDR panorama by name, or a gradient sky of three colours (zenith, horizon, ground).

    Either is scaled so that an unoccluded white floor reflects radiance 1 on average over the
    channels.
    """

    kind: str
    name: str
    rotation: float
    colours: tuple[Colour, Colour, Colour]
    weight: float
    """The share of this light, relative to a dominant light of weight 1, that looks natural in this
    scene."""


@dataclass(frozen=True)
class SceneDescription:
    """One scene, complete; equal (split, seed, options) give equal descriptions."""

    version: int
    split: str
    seed: int
    camera: Camera
    lights: tuple[Light, ...]
    ambient: Ambient
    floor: Material
    floor_yaw: float
    walls: tuple[Wall, ...]
    panels: tuple[Panel, ...]
    clutter: tuple[Item, ...]
    subject: Item
    support_height: float
    """Height of the surface that the subject stands on."""

    def to_json(self) -> str:
        """Return the description as JSON text; numbers keep every digit."""
        return json.dumps(dataclasses.asdict(self), separators=(",", ":"))

    @staticmethod
    def from_json(text: str) -> SceneDescription:
        """Read what `to_json` wrote.

        Raises
        ------
        ValueError
            If the text is of another format version.
        """
        data = json.loads(text)
        if data.get("version") != FORMAT_VERSION:
            raise ValueError(
                f"scene description: expected format version {FORMAT_VERSION}, got "
                f"{data.get('version')!r}. "
                "Render the scene again with this version of spotlight-train."
            )
        return SceneDescription(
            version=data["version"],
            split=data["split"],
            seed=data["seed"],
            camera=Camera(**_tuples(data["camera"])),
            lights=tuple(Light(**_tuples(light)) for light in data["lights"]),
            ambient=Ambient(**_tuples(data["ambient"])),
            floor=_material(data["floor"]),
            floor_yaw=data["floor_yaw"],
            walls=tuple(Wall(**_with_material(wall)) for wall in data["walls"]),
            panels=tuple(Panel(**_with_material(panel)) for panel in data["panels"]),
            clutter=tuple(_item(item) for item in data["clutter"]),
            subject=_item(data["subject"]),
            support_height=data["support_height"],
        )


def direction(azimuth: float, elevation: float) -> np.ndarray:
    """Return the unit vector, shape (3,), from the object towards a light, in the world frame.

    Degrees.
    """
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    return np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])


def camera_axes(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the camera's right, up and forward unit vectors in the world, shape (3,) each."""
    p = np.deg2rad(camera.pitch)
    forward = np.array([0.0, np.cos(p), -np.sin(p)])
    up = np.array([0.0, np.sin(p), np.cos(p)])
    return np.array([1.0, 0.0, 0.0]), up, forward


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Project world points, shape (N, 3), to (x, y, depth).

    X right and y down in [0, 1] over the frame, metres.
    """
    right, up, forward = camera_axes(camera)
    relative = points - np.asarray(camera.position)
    depth = relative @ forward
    scale = 0.5 / np.tan(np.deg2rad(camera.fov) / 2) / np.maximum(depth, 1e-6)
    return np.stack([0.5 + relative @ right * scale, 0.5 - relative @ up * scale, depth], axis=1)


def _tuples(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_tuples(v) for v in value)
    if isinstance(value, dict):
        return {key: _tuples(v) for key, v in value.items()}
    return value


def _material(data: dict[str, Any]) -> Material:
    return Material(**_tuples(data))


def _with_material(data: dict[str, Any]) -> dict[str, Any]:
    return {**_tuples(data), "material": _material(data["material"])}


def _item(data: dict[str, Any]) -> Item:
    return Item(**{**_tuples(data), "materials": tuple(_material(m) for m in data["materials"])})
