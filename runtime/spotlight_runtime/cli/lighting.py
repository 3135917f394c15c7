"""Which lights a command line asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.relighting.guides import Guide, GuidingShadow, Negative
from spotlight_runtime.relighting.lights_file import DEFAULT_ELEVATION, read_lights
from spotlight_runtime.relighting.shadow_files import read_drawing, read_ready_shadow, ready_shadows
from spotlight_runtime.relighting.sweep import ring
from spotlight_runtime.scenes.scene import Scene

__all__ = ["Asked", "Lighting", "choose_lighting"]


_PLACED: Final = ("--azimuth", "--sweep")
_DRAWN: Final = ("--shadow", "a drawn --negative")
_BELONGS: Final = {
    "--elevation": _PLACED,
    "--radius": _PLACED,
    "--distance": _PLACED,
    "--directional": _PLACED,
    "--softness": _DRAWN,
    "--invert": _DRAWN,
}
"""Options that say more of a light, and the ways to give one that they belong to."""


@dataclass(frozen=True, slots=True)
class Asked:
    """The options about light, as typed; None where an option is not given."""

    azimuth: float | None = None
    elevation: float | None = None
    radius: float | None = None
    distance: float | None = None
    directional: bool = False
    shadow: Path | None = None
    negative: str | None = None
    light: str | None = None
    lights: Path | None = None
    sweep: int | None = None
    softness: float | None = None
    invert: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Lights and shadows to relight by.

    Attributes
    ----------
    guides : sequence of Light, GuidingShadow or ndarray
    negative : Light, ndarray, "opposite", "none", or None
        As `Relighter.relight` takes it.
    captions : sequence of str
        One a light.
    """

    guides: Sequence[Guide]
    negative: Negative | None
    captions: Sequence[str]


def choose_lighting(path: Path, scene: Scene, asked: Asked) -> Lighting:
    """Make lights of the options.

    Parameters
    ----------
    path : Path
        The scene's folder or zip.
    scene : Scene
        What lies there.
    asked : Asked

    Raises
    ------
    InvalidInputError
        If none, or more than one, of the ways to give light is taken, or an option is given that
        belongs to another.
    """
    given = {
        "--azimuth": asked.azimuth,
        "--shadow": asked.shadow,
        "--light": asked.light,
        "--lights": asked.lights,
        "--sweep": asked.sweep,
    }
    ways = [name for name, value in given.items() if value is not None]
    if len(ways) != 1:
        got = " and ".join(ways) or "none of them"
        ready = ", ".join(ready_shadows(path))
        known = f"; --light knows here: {ready}" if ready else ""
        raise InvalidInputError(
            f"light: expected one of {', '.join(given)}, got {got}. Say where it is "
            f"(--azimuth 135 --elevation 45), or draw its shadow (--shadow drawing.png){known}"
        )
    negative = _negative(asked, scene)
    _check_further(asked, ways[0], negative)
    if asked.shadow is not None:
        return Lighting([_drawing(asked.shadow, asked, scene)], negative, [asked.shadow.name])
    if asked.light is not None:
        return _ready(path, [asked.light], negative, [asked.light])
    if asked.lights is not None:
        guides = read_lights(asked.lights, scene.object_mask)
        return Lighting(guides, negative, [f"light {i + 1}" for i in range(len(guides))])
    said = {name: getattr(asked, name) for name in ("elevation", "radius", "distance")}
    place: dict[str, Any] = {name: value for name, value in said.items() if value is not None}
    if asked.directional:
        place["distance"] = None
    whole = {"elevation": DEFAULT_ELEVATION, **place}
    if asked.sweep is None:
        light = Light(asked.azimuth, **whole)
        return Lighting([light], negative, [_caption(light)])
    circle = ring(asked.sweep, **whole)
    captions = [_caption(light) for light in circle]
    # A published scene has no mesh to cast from, but may have the shadows of just such a ring.
    numbered = [f"{i:04d}" for i in range(asked.sweep)]
    drawn = set(numbered) <= set(ready_shadows(path))
    if drawn and scene.object_mesh is None and not place:
        return _ready(path, numbered, negative, captions)
    return Lighting(circle, negative, captions)


def _check_further(asked: Asked, way: str, negative: Negative | None) -> None:
    """Raise where an option would do nothing."""
    drawn = negative is not None and not isinstance(negative, str)
    taken = {way, _DRAWN[-1]} if drawn else {way}
    for option, ways in _BELONGS.items():
        value = getattr(asked, option.removeprefix("--"))
        if value is not None and value is not False and taken.isdisjoint(ways):
            raise InvalidInputError(
                f"{option}: expected {' or '.join(ways)} beside it, got {way}; leave one out"
            )
    if asked.directional and asked.distance is not None:
        raise InvalidInputError(
            "--distance: expected none beside --directional, whose light is infinitely far away; "
            "leave one out"
        )


def _ready(
    path: Path, names: Sequence[str], negative: Negative | None, captions: Sequence[str]
) -> Lighting:
    guides: list[GuidingShadow] = [read_ready_shadow(path, name) for name in names]
    if isinstance(negative, str):
        if negative == "none":
            guides = [replace(guide, negative=None) for guide in guides]
    elif negative is not None:
        guides = [GuidingShadow(guide.positive, negative) for guide in guides]  # type: ignore[arg-type]
    return Lighting(guides, None, captions)


def _negative(asked: Asked, scene: Scene) -> Negative | None:
    text = asked.negative
    if text is None or text in ("none", "opposite"):
        return text  # type: ignore[return-value]
    return _drawing(Path(text), asked, scene, blank=True)


def _drawing(path: Path, asked: Asked, scene: Scene, *, blank: bool = False) -> FloatArray:
    mask = scene.object_mask
    return read_drawing(path, mask, softness=asked.softness, invert=asked.invert, blank=blank)


def _caption(light: Light) -> str:
    return f"azimuth {light.azimuth:g}°  elevation {light.elevation:g}°"
