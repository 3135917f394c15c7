"""Ambient light as an equirectangular image.

HDR panoramas tamed to fill light, or a gradient sky.
"""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from .description import Ambient
from .exr import read_rgb
from .mesh import Array

SKY_SHAPE = (128, 256)
PEAK = 6.0
"""Radiance above this many times the mean is cut: the sun of a panorama would be a second dominant
light whose shadow
no guiding shadow describes."""


def default_folder() -> Path:
    """Return where panoramas are kept: $SPOTLIGHT_HDRIS, or a folder in the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return Path(os.environ.get("SPOTLIGHT_HDRIS", cache / "spotlight-relight" / "hdris"))


def sky_image(ambient: Ambient, folder: Path | None) -> Array:
    """Return ambient radiance, float32, shape (128, 256, 3).

    Columns by azimuth from +x, rows from zenith to nadir.

    Scaled so that an unoccluded white floor under it reflects radiance 1, averaged over the
    channels.
    """
    if ambient.kind == "hdri":
        image = _panorama(find_panorama(ambient.name, folder))
        image = np.roll(image, round(ambient.rotation / 360 * SKY_SHAPE[1]), axis=1)
    else:
        image = _gradient(ambient)
    return image / floor_radiance(image)


def floor_radiance(image: Array) -> float:
    """Return the mean radiance of a white floor under an equirectangular image."""
    rows = image.shape[0]
    polar = (np.arange(rows) + 0.5) * np.pi / rows
    weight = (
        np.clip(np.cos(polar), 0, None)
        * np.sin(polar)
        * (np.pi / rows)
        * (2 * np.pi / image.shape[1])
    )
    return float((image.mean(axis=2) * weight[:, None]).sum() / np.pi)


def find_panorama(name: str, folder: Path | None) -> Path:
    """Return the file of a panorama.

    Raises
    ------
    FileNotFoundError
        If the folder has no such image.
    """
    place = folder or default_folder()
    path = place / f"{name}.exr"
    if not path.exists():
        raise FileNotFoundError(
            f"hdris: expected {name}.exr in {place}, found none. "
            "Fetch the panoramas with 'spotlight-train hdris', name "
            "their folder with --hdris DIR, or render under gradient skies alone with --no-hdris."
        )
    return path


@lru_cache(maxsize=8)
def _panorama(path: Path) -> Array:
    image = cv2.resize(read_rgb(path), SKY_SHAPE[::-1], interpolation=cv2.INTER_AREA)
    brightness = image.max(axis=2, keepdims=True)
    solid_angle = np.sin((np.arange(SKY_SHAPE[0]) + 0.5) * np.pi / SKY_SHAPE[0])[:, None, None]
    # Two rounds, because a sun raises the mean that it is measured by.
    for _ in range(2):
        mean = float((brightness * solid_angle).mean() / solid_angle.mean())
        image = image * np.minimum(1.0, PEAK * mean / np.maximum(brightness, 1e-9))
        brightness = image.max(axis=2, keepdims=True)
    # Panoramas run clockwise seen from above, azimuths counter-clockwise.
    return np.ascontiguousarray(image[:, ::-1], dtype=np.float32)


def _gradient(ambient: Ambient) -> Array:
    zenith, horizon, ground = (np.asarray(colour) for colour in ambient.colours)
    height = np.cos((np.arange(SKY_SHAPE[0]) + 0.5) * np.pi / SKY_SHAPE[0])[:, None]
    above = horizon + (zenith - horizon) * np.sqrt(np.clip(height, 0, 1))
    below = horizon + (ground - horizon) * np.clip(-height / 0.1, 0, 1)
    column = np.where(height > 0, above, below)
    azimuth = (np.arange(SKY_SHAPE[1]) + 0.5) * 2 * np.pi / SKY_SHAPE[1]
    # A brighter side, as any sky or window front has, gives ambient light a direction of its own.
    side = 1.0 + 0.5 * np.cos(azimuth - np.deg2rad(ambient.rotation))
    return (column[:, None] * side[None, :, None]).astype(np.float32)
