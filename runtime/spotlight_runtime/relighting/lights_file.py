"""``lights.json``: several lights of one picture, by place or by ready shadow."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import InvalidInputError, SpotLightError, UnsafePathError
from spotlight_runtime.geometry.lights import Light, Vector
from spotlight_runtime.relighting.guides import Guide, GuidingShadow
from spotlight_runtime.relighting.shadow_files import read_shadow
from spotlight_spec import RecordError, decode, read_json

__all__ = ["LightsFile", "ShadowEntry", "read_lights"]


_FIELDS: Final = ", ".join(f.name for f in fields(Light) if f.name != "turned")


@dataclass(frozen=True, slots=True)
class ShadowEntry:
    """A light given by its ready shadow.

    Attributes
    ----------
    shadow : str
        Grey image of the scene's size, white is shadow, in the folder of the file that names it.
    negative : str
        Shadow of the opposite light, likewise; or none.
    weight : float
    colour : (r, g, b)
    """

    shadow: str
    negative: str = "none"
    weight: float = 1.0
    colour: Vector = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class LightsFile:
    """``{"lights": [...]}``: each a `Light` or, where it names a shadow, a `ShadowEntry`."""

    lights: tuple[dict[str, Any], ...]


def read_lights(path: Path) -> list[Guide]:
    """Read the lights of a picture.

    Parameters
    ----------
    path : Path
        ``{"lights": [{"azimuth": 135, "elevation": 45, "weight": 2}, {"shadow": "lamp.png"}]}``;
        the list alone will do.

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
            _guide(entry, f"{path}: lights[{i}]", path.parent) for i, entry in enumerate(entries)
        ]
    except SpotLightError:
        raise
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except RecordError as error:
        raise InvalidInputError(f"{error}. A light has {_FIELDS}, or a shadow") from error


def _guide(entry: dict[str, Any], where: str, folder: Path) -> Guide:
    if "shadow" not in entry:
        return decode(Light, entry, where)
    ready = decode(ShadowEntry, entry, where)

    def read(name: str) -> FloatArray:
        return read_shadow(_inside(folder, name, where))

    negative = None if ready.negative == "none" else read(ready.negative)
    return GuidingShadow(read(ready.shadow), negative, ready.weight, ready.colour)


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
