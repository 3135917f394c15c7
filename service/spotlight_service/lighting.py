"""From the lights of a request to what guides a relight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from spotlight_runtime import GuidingShadow, Light, Scene
from spotlight_runtime.relighting.guides import Guide, Negative
from spotlight_runtime.relighting.shadow_files import read_drawing

__all__ = ["Drawings", "caption", "guides_of", "light_of", "negative_of"]

Drawings = Callable[[int, str], Path]
"""``drawings(number, "shadow" or "negative")``: where a light's drawing lies."""


def light_of(entry: Mapping[str, Any]) -> Light:
    """A placed light.

    Raises
    ------
    InvalidInputError
        If it is nowhere, or out of its domain.
    """
    vectors = {n: tuple(entry[n]) for n in ("position", "colour") if entry.get(n) is not None}
    return Light(**{**entry, **vectors})


def guides_of(lights: Sequence[Mapping[str, Any]], scene: Scene, drawings: Drawings) -> list[Guide]:
    """Lights and drawn shadows of a request.

    Parameters
    ----------
    lights : sequence of mapping
        As `RelightRequest` has them; a drawn one has ``"shadow"``, and its picture in a file.
    scene : Scene
    drawings : callable

    Raises
    ------
    InvalidInputError, ImageFileError
    """
    guides: list[Guide] = []
    for number, entry in enumerate(lights):
        if "shadow" not in entry:
            guides.append(light_of(entry))
            continue

        def drawn(kind: str, number: int = number, entry: Mapping[str, Any] = entry) -> Any:
            return read_drawing(
                drawings(number, kind),
                scene.object_mask,
                softness=entry["softness"],
                invert=entry["invert"],
                blank=kind == "negative",
            )

        negative = None if entry["negative"] is None else drawn("negative")
        shadow = GuidingShadow(drawn("shadow"), negative)
        guides.append(replace(shadow, weight=entry["weight"], colour=tuple(entry["colour"])))
    return guides


def negative_of(entry: str | Mapping[str, Any] | None) -> Negative | None:
    """What the guidance contrasts with, of a request."""
    if entry is None or isinstance(entry, str):
        return entry  # type: ignore[return-value]
    return light_of(entry)


def caption(entry: Mapping[str, Any], number: int) -> str:
    """What stands below a picture of a sweep."""
    if entry.get("azimuth") is None:
        return f"light {number + 1}"
    return f"azimuth {entry['azimuth']:g}°  elevation {entry['elevation']:g}°"
