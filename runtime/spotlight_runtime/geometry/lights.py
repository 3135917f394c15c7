"""A light, as a person places it: by direction, by position, round or without extent."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Final, Literal

from spotlight_runtime.errors import InvalidInputError

__all__ = ["Light", "Vector", "as_float", "three"]


Vector = tuple[float, float, float]

FARTHEST: Final = 1e9
"""Object sizes, or metres of a position: what lies farther is as good as infinitely far, and the
squares of its coordinates leave float32."""
_MOST_ANGULAR_RADIUS: Final = 60.0
"""Degrees; a wider directional light is a sky, which casts no shadow to guide by."""


@dataclass(frozen=True, slots=True)
class Light:
    """A light that casts a guiding shadow.

    It is placed by a direction (``azimuth`` and ``elevation``, seen from the middle of the object)
    and a ``distance``, or else by a ``position``. Lengths in *object sizes* are multiples of the
    longest side of the object's bounding box, so a light means the same for a cup and a sofa.

    Attributes
    ----------
    azimuth : float, optional
        Degrees round the vertical, from the object towards the light: 0 is the camera's right, 90
        away from the camera, 180 the left, 270 towards the camera.
    elevation : float, optional
        Degrees above the horizontal, −90 to 90.
    radius : float
        How large the light is, and so how soft its shadow; 0 for a hard edge. Object sizes; for a
        directional light (``distance`` None) degrees, half the angle under which the light is
        seen (the sun's is 0.27).
    distance : float, optional
        Object sizes from the middle of the object, up to 1e9; None for a light infinitely far
        away.
    position : (x, y, z), optional
        Instead of azimuth, elevation and distance, in the unit of the depth maps (metres). In the
        world frame from the middle of the object's base: right, away from the camera, up. In the
        camera frame from the camera: right, up, towards the viewer.
    frame : {"world", "camera"}
        Whether the horizontal is the floor's, or the camera's.
    weight : float
        Its share where several lights are combined, ≥ 0.
    colour : (r, g, b)
        Its linear colour where several lights are combined, each ≥ 0.
    turned : bool
        Half a turn round the object is still to be made (`opposite` of a light in the camera's
        coordinates, where the object's place is not known yet).
    """

    azimuth: float | None = None
    elevation: float | None = None
    radius: float = 1.0
    distance: float | None = 10.0
    position: Vector | None = None
    frame: Literal["world", "camera"] = "world"
    weight: float = 1.0
    colour: Vector = (1.0, 1.0, 1.0)
    turned: bool = False

    def __post_init__(self) -> None:
        self._check_place()
        self._check("radius", 0.0, FARTHEST)
        if self.directional:
            _checked(self.radius, "radius of a directional light", 0.0, _MOST_ANGULAR_RADIUS)
        if self.frame not in ("world", "camera"):
            raise InvalidInputError(f"frame: expected world or camera, got {self.frame!r}")
        self._check("weight", 0.0, math.inf)
        self._check_each("colour", "red, green, blue", 0.0, math.inf)

    @property
    def directional(self) -> bool:
        """Whether the light is infinitely far away."""
        return self.position is None and self.distance is None

    def opposite(self) -> Light:
        """The light across the object, for the negative shadow: azimuth + 180°."""
        if self.position is None:
            assert self.azimuth is not None
            return replace(self, azimuth=(self.azimuth + 180.0) % 360.0)
        if self.frame == "camera":
            return replace(self, turned=not self.turned)
        x, y, z = self.position
        return replace(self, position=(-x, -y, z))

    def _check_place(self) -> None:
        if self.position is None:
            if self.azimuth is None or self.elevation is None:
                raise InvalidInputError(
                    "light: expected azimuth and elevation in degrees, or a position, got "
                    f"azimuth {self.azimuth} and elevation {self.elevation}"
                )
            self._check("azimuth", -math.inf, math.inf)
            self._check("elevation", -90.0, 90.0)
            if self.distance is not None:
                self._check("distance", 0.0, FARTHEST, open_below=True)
            return
        if self.azimuth is not None or self.elevation is not None:
            raise InvalidInputError(
                "light: expected azimuth and elevation or a position, got both; leave one out"
            )
        self._check_each("position", "x, y, z", -FARTHEST, FARTHEST)

    def _check(self, name: str, low: float, high: float, open_below: bool = False) -> None:
        """Check a number, and keep it as Python's own."""
        value = _checked(getattr(self, name), name, low, high, open_below)
        object.__setattr__(self, name, value)

    def _check_each(self, name: str, parts: str, low: float, high: float) -> None:
        """Likewise three of them."""
        values = three(getattr(self, name), name, parts)
        object.__setattr__(self, name, tuple(_checked(v, name, low, high) for v in values))


def as_float(value: object) -> float:
    """A real number of whatever type as Python's own; NaN, which no range has, for what is none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:  # of an integer
        return math.inf


def three(values: Any, name: str, parts: str) -> tuple[Any, ...]:
    """The parts of a colour or a position, each still to be checked."""
    try:
        found = tuple(values)
    except TypeError:
        found = ()
    if len(found) != 3:
        raise InvalidInputError(f"{name}: expected {parts}, got {values!r}")
    return found


def _checked(value: Any, name: str, low: float, high: float, open_below: bool = False) -> float:
    number = as_float(value)
    inside = math.isfinite(number) and low <= number <= high
    if not inside or (open_below and number == low):
        bounds = f"above {low:g} and up to {high:g}" if open_below else f"from {low:g} to {high:g}"
        raise InvalidInputError(f"{name}: expected a finite number {bounds}, got {value!r}")
    return number
