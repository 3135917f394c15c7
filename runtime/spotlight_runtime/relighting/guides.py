"""Guiding shadows of a relight: cast from lights, or ready arrays, with what combines them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from spotlight_runtime.arrays import FloatArray, check_array
from spotlight_runtime.errors import DtypeError, InvalidInputError, LightError
from spotlight_runtime.geometry.lights import Light, Vector, as_float, three
from spotlight_runtime.relighting.casting import Cast, caster_of, say_of
from spotlight_runtime.scenes.scene import Scene

__all__ = ["Guide", "GuidingShadow", "Negative", "giving_light", "guiding_shadows"]


@dataclass(frozen=True, slots=True, eq=False)
class GuidingShadow:
    """The shadow that says where a light is.

    Attributes
    ----------
    positive : ndarray of float32, shape (H, W)
        Shadow of the wanted light in [0, 1], 1 = fully shadowed. What lies under the object is
        ignored.
    negative : ndarray of float32, shape (H, W), optional
        Shadow of the negative branch: the light opposite, or another drawing. None: no shadow.
    weight : float
        Share of this light where several are combined, ≥ 0.
    colour : (r, g, b)
        Linear colour of this light where several are combined, each ≥ 0.
    """

    positive: FloatArray
    negative: FloatArray | None = None
    weight: float = 1.0
    colour: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        colour = three(self.colour, "colour", "red, green, blue")
        for name, value in (("weight", self.weight), *(("colour", c) for c in colour)):
            number = as_float(value)
            if not (math.isfinite(number) and number >= 0.0):
                raise InvalidInputError(f"{name}: expected a finite number ≥ 0, got {value!r}")
        object.__setattr__(self, "weight", as_float(self.weight))
        object.__setattr__(self, "colour", tuple(map(as_float, colour)))

    def check(self, size: tuple[int, int], of: str = "") -> None:
        """Raise unless both shadows are of the scene's size and in range.

        Raises
        ------
        DtypeError, ShapeError, NonFiniteError, InvalidInputError
        """
        check_array(self.positive, f"shadow{of}", size, None, (0.0, 1.0))
        if self.negative is not None:
            check_array(self.negative, f"negative{of}", size, None, (0.0, 1.0))


Guide = Light | GuidingShadow | FloatArray
"""What a relight is guided by: a light, whose shadow is cast, or a ready shadow."""
Negative = Light | FloatArray | Literal["opposite", "none"]
"""Shadow of the negative branch: of the light opposite, none, of another light, or ready."""


def giving_light(guide: Guide | Sequence[Guide]) -> Guide | Sequence[Guide]:
    """Of several lights those that a picture of them all shows; all where there are none."""
    if not isinstance(guide, Sequence):
        return guide
    return [each for each in guide if _gives_light(each)] or guide


def _gives_light(guide: Guide) -> bool:
    """Whether a light has weight and colour; a bare shadow has both."""
    if isinstance(guide, Light | GuidingShadow):
        return guide.weight > 0.0 and any(guide.colour)
    return True


def guiding_shadows(
    scene: Scene, guide: Guide | Sequence[Guide], negative: Negative | None = None
) -> tuple[GuidingShadow, ...]:
    """Make of lights and arrays the shadows that guide.

    Parameters
    ----------
    scene : Scene
    guide : Light, GuidingShadow, ndarray of float32 of shape (H, W), or a sequence of them
        Several are several lights.
    negative : Light, ndarray, "opposite", "none", optional
        By default the light opposite for a light, and no shadow for a ready shadow, or where the
        light opposite would be in the object or below the floor, which a warning says.

    Returns
    -------
    tuple of GuidingShadow
        In the given order, checked.

    Raises
    ------
    InvalidInputError
        If there is no light, the negative does not go with it, or a shadow is out of range.
    GroundError, MissingExtraError
        If the scene has nothing to cast shadows on, or what casts them is not installed.
    LightError
        If a light is where none can be.
    """
    guides = tuple(guide) if isinstance(guide, Sequence) else (guide,)
    if not guides:
        raise InvalidInputError("lights: expected at least one, got none")
    for each in guides:
        if not isinstance(each, Light | GuidingShadow | np.ndarray):
            raise DtypeError(
                f"shadow: expected a light or a float32 array, got {type(each).__name__}; "
                "convert it first"
            )
    if len(guides) > 1 and not (negative is None or isinstance(negative, str)):
        raise InvalidInputError(
            "negative: expected opposite or none for several lights; give each its own as "
            "GuidingShadow(positive, negative)"
        )
    lights = (*guides, negative)
    cast = caster_of(scene) if any(isinstance(each, Light) for each in lights) else None
    made = []
    for number, each in enumerate(guides, start=1):
        shadow = _guiding_shadow(cast, each, negative)
        shadow.check(scene.size, f" {number}" if len(guides) > 1 else "")
        made.append(shadow)
    return tuple(made)


def _guiding_shadow(cast: Cast | None, guide: Guide, negative: Negative | None) -> GuidingShadow:
    if isinstance(negative, str) and negative not in get_args(get_args(Negative)[-1]):
        raise InvalidInputError(
            f"negative: expected opposite, none, a light or a shadow, got {negative!r}"
        )
    if isinstance(guide, GuidingShadow):
        if negative is not None:
            raise InvalidInputError("negative: expected none beside a GuidingShadow, which has one")
        return guide
    if isinstance(guide, Light):
        assert cast is not None
        shadow, across = cast(guide, True), _contrast(cast, guide, negative)
        return GuidingShadow(shadow, across, guide.weight, guide.colour)
    if isinstance(negative, str) and negative == "opposite":
        raise InvalidInputError(
            "negative: the opposite of a ready shadow is not known; give it as a shadow of its "
            "own, or none"
        )
    return GuidingShadow(guide, _drawn(cast, negative))


def _contrast(cast: Cast, light: Light, negative: Negative | None) -> FloatArray | None:
    """The negative shadow of a light, by default that of the light opposite if there can be one."""
    asked_for = isinstance(negative, str) and negative == "opposite"
    if not (negative is None or asked_for):
        return _drawn(cast, negative)
    try:
        return cast(light.opposite(), False)
    except LightError as error:
        if asked_for:
            raise LightError(
                f'negative: the opposite {error}; or choose no shadow (negative "none")'
            ) from error
        say_of(light, "there is no place for the light opposite; it is contrasted with no shadow")
        return None


def _drawn(cast: Cast | None, negative: Negative | None) -> FloatArray | None:
    if isinstance(negative, Light):
        assert cast is not None
        return cast(negative, False)
    return None if negative is None or isinstance(negative, str) else negative
