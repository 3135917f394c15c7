"""Guiding shadows from image files: drawn by hand, or lying ready in a scene's folder.

A scene of the published test set brings its shadows along: ``shadow_positive_NAME.png`` and, of
the opposite light, ``shadow_negative_NAME.png``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import InvalidInputError, NonFiniteError
from spotlight_runtime.imaging.images import read_image
from spotlight_runtime.relighting.guides import GuidingShadow
from spotlight_runtime.shadows.scribble import check_shadow, clean_scribble, grey_of

__all__ = ["read_drawing", "read_ready_shadow", "read_shadow", "ready_shadows"]


_POSITIVE: Final = "shadow_positive_{}.png"
_NEGATIVE: Final = "shadow_negative_{}.png"


def read_shadow(path: Path) -> FloatArray:
    """Read a guiding shadow from an image: its luma times alpha, white is shadow.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Clipped to [0, 1].

    Raises
    ------
    ImageFileError
        If the file cannot be read.
    NonFiniteError
        If it holds NaN or infinity.
    """
    pixels = read_image(path)
    if not np.isfinite(pixels).all():
        raise NonFiniteError(
            f"{path}: the shadow holds NaN or infinity; expected values in [0, 1], write it again"
        )
    return np.clip(grey_of(pixels), 0.0, 1.0)


def read_drawing(
    path: Path,
    object_mask: FloatArray,
    *,
    softness: float | None = None,
    invert: bool = False,
    blank: bool = False,
) -> FloatArray:
    """Read a guiding shadow, or a drawing of one, of any size.

    An image of the scene's size counts as it is, unless it is to be softened or inverted. Any
    other is taken for a scribble, stretched to the scene and cleaned (`clean_scribble`).

    Parameters
    ----------
    path : Path
    object_mask : ndarray of float32, shape (H, W)
    softness : float, optional
        Pixels over which its edges fade.
    invert : bool
        Black is shadow.
    blank : bool
        One of the scene's size may be without shadow, as that of a light opposite.

    Returns
    -------
    ndarray of float32, shape (H, W)

    Raises
    ------
    ImageFileError
        If the file cannot be read.
    InvalidInputError
        If nothing is drawn on it, or it seems to be inverted.
    """
    if softness is None and not invert:
        shadow = read_shadow(path)
        if shadow.shape == object_mask.shape:
            check_shadow(shadow, blank=blank)
            return shadow
    drawing = read_image(path)
    return clean_scribble(drawing, object_mask, softness=softness or 0.0, invert=invert)


def ready_shadows(scene: Path) -> list[str]:
    """Names of the lights whose shadows lie ready in a scene's folder, sorted."""
    before, after = _POSITIVE.split("{}")
    found = scene.glob(_POSITIVE.format("*")) if scene.is_dir() else ()
    return sorted(path.name.removeprefix(before).removesuffix(after) for path in found)


def read_ready_shadow(scene: Path, name: str) -> GuidingShadow:
    """Read the ready shadow of a light, and that of the light opposite where there is one.

    Parameters
    ----------
    scene : Path
        The scene's folder.
    name : str
        As `ready_shadows` lists it.

    Raises
    ------
    InvalidInputError
        If there is no such light; the message names those there are.
    """
    known = ready_shadows(scene)
    if name not in known:
        there = ", ".join(known) or "none"
        raise InvalidInputError(
            f"{scene}: expected {_POSITIVE.format(name)} for the light {name!r}; ready shadows "
            f"here: {there}. Place the light instead (azimuth and elevation), or give its shadow"
        )
    negative = scene / _NEGATIVE.format(name)
    opposite = read_shadow(negative) if negative.is_file() else None
    return GuidingShadow(read_shadow(scene / _POSITIVE.format(name)), opposite)
