"""The photograph an object is put into: linear radiance and how wide the camera saw."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import ImageFileError, InvalidInputError, NonFiniteError, ShapeError
from spotlight_runtime.geometry.camera import DEFAULT_FIELD_OF_VIEW, Camera
from spotlight_runtime.imaging.colour import stored_to_linear
from spotlight_runtime.imaging.decoding import decode_pixels, read_bytes
from spotlight_runtime.imaging.headers import ImageHeader, read_header
from spotlight_runtime.imaging.images import read_image
from spotlight_runtime.imaging.picture_files import LINEAR_SUFFIXES

__all__ = [
    "SMALLEST_SIDE",
    "Photograph",
    "crop_panorama",
    "expose",
    "field_of_view_of",
    "horizon_of",
    "read_photograph",
]


SMALLEST_SIDE: Final = 32
"""Pixels; below this the networks that read the picture see nothing."""
FRAME_DIAGONAL: Final = math.hypot(36.0, 24.0)
"""Millimetres; EXIF's 35 mm focal length is that of a frame with this diagonal."""
BRIGHT_SHARE: Final = 95.0
"""Percentile of a linear picture that `expose` makes bright, so that only highlights clip."""
BRIGHT_VALUE: Final = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """A picture of a place, without the object.

    Attributes
    ----------
    radiance : ndarray of float32, shape (H, W, 3)
        Linear light ≥ 0; 1 is the white of a display.
    field_of_view : float
        Horizontal, degrees.
    name : str
    file : Path, optional
        The sRGB-encoded file whose pixels these are, if they are nothing else.
    """

    radiance: FloatArray
    field_of_view: float = DEFAULT_FIELD_OF_VIEW
    name: str = "photograph"
    file: Path | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.radiance.shape[0], self.radiance.shape[1]

    @property
    def camera(self) -> Camera:
        """The camera that took it."""
        return Camera(self.size[1], self.size[0], self.field_of_view)


def read_photograph(
    path: str | Path, field_of_view: float | None = None, exposure: float | None = None
) -> Photograph:
    """Read a photograph of any size, orientation applied.

    Parameters
    ----------
    path : str or Path
        PNG, JPEG or WebP (sRGB-encoded), Radiance HDR or OpenEXR (linear).
    field_of_view : float, optional
        Horizontal, degrees; from EXIF if not given, or 50.
    exposure : float, optional
        Stops to brighten by. If not given, encoded pictures stay as they are and linear ones are
        exposed for a display (`expose`).

    Raises
    ------
    ImageFileError
        If it is no whole image, or a gigantic one.
    NonFiniteError, ShapeError
        If it holds NaN or infinity, or is smaller than `SMALLEST_SIDE`.
    """
    path = Path(path)
    header: ImageHeader | None = None
    if path.suffix.lower() in LINEAR_SUFFIXES:
        pixels = read_image(path)
    else:
        data = read_bytes(path)
        pixels = decode_pixels(data, path)
        header = read_header(data)
    encoded = np.issubdtype(pixels.dtype, np.integer)
    radiance = _three_channels(stored_to_linear(pixels, "srgb" if encoded else "linear"), path)
    if min(radiance.shape[:2]) < SMALLEST_SIDE:
        raise ShapeError(
            f"{path}: expected at least {SMALLEST_SIDE}×{SMALLEST_SIDE} pixels, "
            f"got {radiance.shape[1]}×{radiance.shape[0]}; use a larger picture"
        )
    if path.suffix.lower() in LINEAR_SUFFIXES:
        _check_linear(radiance, path)
    if exposure is not None:
        radiance *= np.float32(2.0**exposure)
    elif path.suffix.lower() in LINEAR_SUFFIXES:
        radiance = expose(radiance)
    if field_of_view is None:
        field_of_view = field_of_view_of(header) or DEFAULT_FIELD_OF_VIEW
    faithful = encoded and exposure is None and pixels.ndim == 3 and pixels.shape[2] >= 3
    return Photograph(radiance, field_of_view, path.stem, path if faithful else None)


def field_of_view_of(header: ImageHeader | None) -> float | None:
    """Horizontal field of view in degrees that EXIF's 35 mm focal length means, if there is one."""
    if header is None or header.focal_35mm is None:
        return None
    share = header.width / math.hypot(header.width, header.height)
    return math.degrees(2.0 * math.atan(0.5 * FRAME_DIAGONAL * share / header.focal_35mm))


def expose(radiance: FloatArray) -> FloatArray:
    """Scale linear radiance, shape (H, W, 3), so that its bright parts just fit a display."""
    bright = float(np.percentile(radiance.max(axis=2), BRIGHT_SHARE))
    if bright <= 0.0:
        return radiance
    return radiance * np.float32(BRIGHT_VALUE / bright)


def crop_panorama(panorama: Photograph, yaw: float, pitch: float, camera: Camera) -> Photograph:
    """Take a perspective view out of an equirectangular panorama.

    Parameters
    ----------
    panorama : Photograph
        Twice as wide as high: longitude runs over the width, the horizon is in the middle.
    yaw, pitch : float
        Degrees the view turns to the right of the panorama's middle, and above its horizon.
    camera : Camera
        Size and field of view of the crop.

    Raises
    ------
    ShapeError
        If the picture is not twice as wide as high.
    InvalidInputError
        If the pitch is not between −90 and 90.
    """
    height, width = panorama.size
    if abs(width - 2 * height) > 0.02 * width:
        raise ShapeError(
            f"{panorama.name}: expected an equirectangular panorama, twice as wide as high, got "
            f"{width}×{height}; leave --panorama out for an ordinary photograph"
        )
    if not -90.0 <= pitch <= 90.0:
        raise InvalidInputError(f"pitch: expected degrees between -90 and 90, got {pitch:g}")
    source = panorama.radiance
    # Shrunk first where the crop is coarser than the panorama, so that nothing aliases.
    density = width / 360.0 / (camera.width / camera.field_of_view)
    if density > 1.0:
        shrunk = (max(2, round(width / density)), max(1, round(height / density)))
        source = np.asarray(cv2.resize(source, shrunk, interpolation=cv2.INTER_AREA))
    height, width = source.shape[:2]
    tilt = math.radians(pitch)
    rays = camera.rays()
    up = math.cos(tilt) * rays[..., 1] - math.sin(tilt) * rays[..., 2]
    away = -math.sin(tilt) * rays[..., 1] - math.cos(tilt) * rays[..., 2]
    longitude = np.arctan2(rays[..., 0], away) + math.radians(yaw)
    latitude = np.arctan2(up, np.hypot(rays[..., 0], away))
    x = np.mod((longitude / (2.0 * math.pi) + 0.5) * width - 0.5, width).astype(np.float32)
    y = np.clip((0.5 - latitude / math.pi) * height - 0.5, 0.0, height - 1.0).astype(np.float32)

    def look(image: FloatArray, kind: int) -> FloatArray:
        return np.asarray(cv2.remap(image, x, y, kind, borderMode=cv2.BORDER_WRAP))

    # Cubic interpolation rings around lamps, which are thousands of times as bright as what is
    # around them; what the neighbours have bounds it.
    near = np.ones((3, 3), np.uint8)
    darkest = look(cv2.erode(source, near), cv2.INTER_NEAREST)
    brightest = look(cv2.dilate(source, near), cv2.INTER_NEAREST)
    radiance = np.clip(look(source, cv2.INTER_CUBIC), darkest, brightest)
    return Photograph(radiance, camera.field_of_view, panorama.name)


def horizon_of(camera: Camera, pitch: float) -> float:
    """Row of the horizon in a view pitched by so many degrees, as a fraction of the height."""
    return 0.5 + camera.focal * math.tan(math.radians(pitch)) / camera.height


def _three_channels(image: FloatArray, path: Path) -> FloatArray:
    """Grey is repeated, alpha left out."""
    planes = image[..., None] if image.ndim == 2 else image
    if planes.shape[2] in (1, 2):
        return np.repeat(planes[..., :1], 3, axis=2)
    if planes.shape[2] > 4:
        raise ImageFileError(f"{path}: expected a grey or colour image, got shape {image.shape}")
    return np.ascontiguousarray(planes[..., :3])


def _check_linear(radiance: FloatArray, path: Path) -> None:
    """Refuse NaN and infinity; what is below 0 (lens and debayering residue) becomes 0."""
    if not np.isfinite(radiance).all():
        bad = int(radiance.size - np.isfinite(radiance).sum())
        raise NonFiniteError(
            f"{path}: {bad} of {radiance.size} values are NaN or infinite; "
            "replace them and export the picture again"
        )
    np.maximum(radiance, np.float32(0.0), out=radiance)
