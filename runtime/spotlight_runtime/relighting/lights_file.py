"""``lights.json``: several lights of one picture, by place or by shadow."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import InvalidInputError, SpotLightError, UnsafePathError
from spotlight_runtime.geometry.lights import Light, Vector
from spotlight_runtime.relighting.guides import Guide, GuidingShadow
from spotlight_runtime.relighting.shadow_files import read_drawing
from spotlight_spec import RecordError, decode, read_json

__all__ = ["DEFAULT_ELEVATION", "LightsFile", "ShadowEntry", "read_lights"]


DEFAULT_ELEVATION: Final = 45.0
"""Degrees above the floor of a light of which only the azimuth is said."""
_FIELDS: Final = ", ".join(f.name for f in fields(Light) if f.name != "turned")


@dataclass(frozen=True, slots=True)
class ShadowEntry:
    """A light given by its shadow.

    Attributes
    ----------
    shadow : str
        Image of it in the folder of the file that names it, as `read_drawing` takes it: white is
        shadow, and of another size than the scene's it is a drawing, which is cleaned.
    negative : str
        Shadow of the opposite light, likewise; or none.
    softness : float, optional
        Pixels over which its edges fade.
    invert : bool
        Black is shadow.
    weight : float
    colour : (r, g, b)
    """

    shadow: str
    negative: str = "none"
    softness: float | None = None
    invert: bool = False
    weight: float = 1.0
    colour: Vector = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class LightsFile:
    """``{"lights": [...]}``: each a `Light` or, where it names a shadow, a `ShadowEntry`."""

    lights: tuple[dict[str, Any], ...]


def read_lights(path: Path, object_mask: FloatArray) -> list[Guide]:
    """Read the lights of a picture.

    Parameters
    ----------
    path : Path
        ``{"lights": [{"azimuth": 135, "elevation": 45, "weight": 2}, {"shadow": "lamp.png"}]}``;
        the list alone will do, and an azimuth alone: the elevation is then `DEFAULT_ELEVATION`.
    object_mask : ndarray of float32, shape (H, W)
        Of the scene.

    Returns
    -------
    list of Light or GuidingShadow

    Raises
    ------
    InvalidInputError
        If the file is no such list, or a light in it is out of its domain.
    ImageFileError
        If a shadow cannot be read.
    UnsafePathError
        If it lies outside the folder of the lights.
    """
    try:
        document = read_json(path)
        if isinstance(document, list):
            document = {"lights": document}
        entries = decode(LightsFile, document, str(path)).lights
        if not entries:
            raise InvalidInputError(f"{path}: expected at least one light, the list is empty")
        return [
            _guide(entry, f"{path}: lights[{i}]", path.parent, object_mask)
            for i, entry in enumerate(entries)
        ]
    except SpotLightError:
        raise
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except RecordError as error:
        raise InvalidInputError(f"{error}. A light has {_FIELDS}, or a shadow") from error


def _guide(entry: dict[str, Any], where: str, folder: Path, object_mask: FloatArray) -> Guide:
    if "shadow" not in entry:
        usual = {"elevation": DEFAULT_ELEVATION} if "azimuth" in entry else {}
        return decode(Light, {**usual, **entry}, where)
    drawn = decode(ShadowEntry, entry, where)

    def read(name: str, *, blank: bool = False) -> FloatArray:
        path = _inside(folder, name, where)
        try:
            return read_drawing(
                path, object_mask, softness=drawn.softness, invert=drawn.invert, blank=blank
            )
        except InvalidInputError as error:
            raise type(error)(f"{where}: {name}: {error}") from error

    negative = None if drawn.negative == "none" else read(drawn.negative, blank=True)
    return GuidingShadow(read(drawn.shadow), negative, drawn.weight, drawn.colour)


def _inside(folder: Path, name: str, where: str) -> Path:
    """The path of a shadow, which must lie in the folder of the file that names it."""
    try:
        path = (folder / name).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # a null byte, a symlink to itself
        raise InvalidInputError(f"{where}: {name!r} is no file: {error}") from error
    if not path.is_relative_to(folder.resolve()):
        raise UnsafePathError(
            f"{where}: {name!r} lies outside the folder of the lights; copy it there"
        )
    return path
