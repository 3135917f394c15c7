"""What the service tells of a scene."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["SceneInfo"]


@dataclass(frozen=True, slots=True)
class SceneInfo:
    """Facts about a stored scene.

    Attributes
    ----------
    id : str
        SHA-256 of what it was made of.
    name : str
    width, height : int
        Pixels.
    field_of_view : float
        Horizontal, degrees.
    object_box : (left, top, right, bottom)
        Of the object in the picture, in fractions of width and height.
    coverage : float
        Share of the picture that the object covers.
    floor_normal : (x, y, z), optional
        Upwards, camera space: x right, y up, z towards the camera. None: no floor is known.
    casts : bool
        Whether shadows of lights can be cast; without, shadows have to be drawn.
    summary : str
        What was found and made, for a person.
    """

    id: str
    name: str
    width: int
    height: int
    field_of_view: float
    object_box: tuple[float, float, float, float]
    coverage: float
    floor_normal: tuple[float, float, float] | None
    casts: bool
    summary: str
