"""Lights all round the object: a contact sheet and an animation of what each makes of it."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import ImageFileError, InvalidInputError, MissingExtraError
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.relighting.window import shrink
from spotlight_spec import replacing

__all__ = ["Tile", "check_animation", "contact_sheet", "make_tile", "ring", "write_animation"]


TILE_SIDE: Final = 512
"""Longest side of a picture on the sheet."""
INSET: Final = 0.3
"""Side of the guiding shadow's inset, as a share of its picture's."""
INSET_GREY: Final = 0.55
"""The object's silhouette in the inset, between white ground and black shadow."""
CAPTION: Final = 34
GAP: Final = 8
FRAMES_PER_SECOND: Final = 4
ANIMATIONS: Final = (".mp4", ".gif", ".webp")


def ring(
    count: int, elevation: float = 45.0, radius: float = 1.0, distance: float | None = 10.0
) -> list[Light]:
    """Lights evenly all round the object, from the camera's right against the clock.

    Raises
    ------
    InvalidInputError
        If there is not at least one.
    """
    if count < 1:
        raise InvalidInputError(f"sweep: expected at least one light, got {count}")
    return [Light(360.0 * i / count, elevation, radius, distance) for i in range(count)]


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """One picture of a sheet: ndarray of float32, shape (h, w, 3), sRGB in [0, 1]; its caption."""

    picture: FloatArray
    caption: str


def make_tile(image: FloatArray, shadow: FloatArray, object_mask: FloatArray, caption: str) -> Tile:
    """Shrink a picture to the sheet and set its guiding shadow into the upper right corner.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W, 3)
        sRGB-encoded.
    shadow, object_mask : ndarray of float32, shape (H, W)
    caption : str

    Returns
    -------
    Tile
    """
    size = _within(image.shape[:2], TILE_SIDE)
    picture = shrink(image, size).copy()
    inset = _within(size, int(INSET * max(size)))
    ground = np.float32(1.0) - shrink(shadow, inset)
    mask = shrink(object_mask, inset)
    drawn = ground * (np.float32(1.0) - mask) + np.float32(INSET_GREY) * mask
    height, width = inset
    picture[:height, -width:] = drawn[..., None]
    cv2.rectangle(picture, (size[1] - width - 1, -1), (size[1], height), (1.0, 1.0, 1.0), 1)
    return Tile(picture, caption)


def contact_sheet(tiles: Sequence[Tile]) -> FloatArray:
    """Lay tiles of one size out, captions below, up to four in a row.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        On white.
    """
    columns = min(4, len(tiles))
    rows = -(-len(tiles) // columns)
    height, width = tiles[0].picture.shape[:2]
    pitch = height + CAPTION + GAP, width + GAP
    sheet = np.ones((rows * pitch[0] + GAP, columns * pitch[1] + GAP, 3), dtype=np.float32)
    for i, tile in enumerate(tiles):
        top = GAP + (i // columns) * pitch[0]
        left = GAP + (i % columns) * pitch[1]
        sheet[top : top + height, left : left + width] = tile.picture
        below = np.s_[top + height : top + height + CAPTION, left : left + width]
        sheet[below] = _caption(tile.caption, width)
    return sheet


def check_animation(path: Path) -> None:
    """Raise what `write_animation` would of this name, before there is anything to write.

    Raises
    ------
    InvalidInputError
        If no animation goes by this suffix, or its folder does not exist.
    MissingExtraError
        If what writes it is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in ANIMATIONS:
        raise InvalidInputError(f"{path}: expected one of {', '.join(ANIMATIONS)}, got {suffix!r}")
    if not path.parent.is_dir():
        raise InvalidInputError(f"{path}: cannot be written: there is no folder {path.parent}")
    needed = ("PIL", "imageio", "imageio_ffmpeg") if suffix == ".mp4" else ("PIL",)
    if any(importlib.util.find_spec(name) is None for name in needed):
        raise MissingExtraError(
            f"{path}: animations need Pillow and imageio: pip install 'spotlight-relight[scene]', "
            "or leave the animation out"
        )


def write_animation(path: Path, pictures: Iterable[FloatArray]) -> None:
    """Write pictures of one size as a looping animation.

    Parameters
    ----------
    path : Path
        ``.mp4``, ``.gif`` or ``.webp``.
    pictures : iterable of ndarray of float32, shape (H, W, 3)
        sRGB-encoded, in [0, 1].

    Raises
    ------
    InvalidInputError, MissingExtraError
        See `check_animation`.
    """
    check_animation(path)
    frames = [_eight_bit(picture) for picture in pictures]
    try:
        with replacing(path, keep_suffix=True) as unfinished:
            if path.suffix.lower() == ".mp4":
                _write_film(unfinished, frames)
            else:
                _write_loop(unfinished, frames)
    except OSError as error:
        raise ImageFileError(f"{path}: cannot be written: {error.strerror or error}") from error


def _write_loop(path: Path, frames: Sequence[npt.NDArray[np.uint8]]) -> None:
    from PIL import Image

    first, *others = [Image.fromarray(frame) for frame in frames]
    first.save(
        path,
        save_all=True,
        append_images=others,
        duration=round(1000 / FRAMES_PER_SECOND),
        loop=0,
        **({"quality": 90} if path.suffix.lower() == ".webp" else {}),
    )


def _write_film(path: Path, frames: Sequence[npt.NDArray[np.uint8]]) -> None:
    import imageio.v2

    with imageio.v2.get_writer(
        path, fps=FRAMES_PER_SECOND, quality=8, macro_block_size=1, format="FFMPEG"
    ) as film:
        for frame in frames:
            even = frame.shape[0] // 2 * 2, frame.shape[1] // 2 * 2  # what the codec takes
            film.append_data(frame[: even[0], : even[1]])


def _eight_bit(picture: FloatArray) -> npt.NDArray[np.uint8]:
    return np.round(np.clip(picture, 0.0, 1.0) * 255).astype(np.uint8)


def _within(size: tuple[int, ...], side: int) -> tuple[int, int]:
    """Height and width shrunk to a longest side, never enlarged."""
    factor = min(1.0, side / max(size[:2]))
    return max(1, round(size[0] * factor)), max(1, round(size[1] * factor))


def _caption(text: str, width: int) -> FloatArray:
    """Black on white, shape (`CAPTION`, width, 3).

    OpenCV's stroke fonts lack the degree sign; a small ring stands in for it.
    """
    strip = np.full((CAPTION, width, 3), 255, dtype=np.uint8)  # OpenCV writes on bytes alone
    font, scale, black, left, baseline = cv2.FONT_HERSHEY_SIMPLEX, 0.55, (0, 0, 0), 2, 24
    for piece in text.replace("°", "\0°\0").split("\0"):
        if piece == "°":
            cv2.circle(strip, (left + 3, baseline - 10), 2, black, 1, cv2.LINE_AA)
            left += 8
        elif piece:
            cv2.putText(strip, piece, (left, baseline), font, scale, black, 1, cv2.LINE_AA)
            left += cv2.getTextSize(piece, font, scale, 1)[0][0]
    return strip.astype(np.float32) / np.float32(255)
