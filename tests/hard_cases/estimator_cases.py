"""Maps estimated from photographs: what the network may say, and what it may be shown."""

from __future__ import annotations

from functools import partial

import numpy as np

from spotlight_runtime.composing.estimator import estimate_intrinsics, estimate_small
from spotlight_runtime.composing.photograph import Photograph

from .case import Case
from .relight_cases import with_background

__all__ = ["CASES"]

SIZE = (64, 96)
BACKGROUNDS = ("0", "1", "red", "checker", "1e6", "1e30", "1e-40", "3e38")
NORMALS = {
    "0": (0.0, 0.0, 0.0),
    "1e-40": (1e-40, 0.0, -1e-40),
    "0.3": (0.3, -0.2, 0.1),
    "1e25": (1e25, -1e25, 1e20),
    "3e38": (3e38, 3e38, 3e38),
}


def network_saying(normal: tuple[float, float, float], albedo: float, depth: float):
    def network(image: np.ndarray) -> dict[str, np.ndarray]:
        said = np.float32([albedo, albedo, albedo, *normal, depth])
        maps = np.broadcast_to(said[None, :, None, None], (1, 7, *image.shape[2:]))
        return {"maps": maps.copy()}

    return network


def photograph(background: str) -> Photograph:
    return Photograph(with_background(background, SIZE).background, name=background)


def _normal(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Of unit length, or as good as none where the network gives no direction."""
    said = np.float64(np.float32(NORMALS[name]))
    maps = estimate_small(network_saying(NORMALS[name], 0.5, 1.0), photograph("1"))
    length = np.linalg.norm(said)
    expected = said / length if length > 1e-6 else np.zeros(3)
    assert maps.normal.dtype == np.float32
    return maps.normal[3, 4], expected


def _maps(background: str, albedo: float, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Of one colour and depth: the network's, within their range.

    Where the photograph has no light in some channel, or more than float32 can divide, or edges,
    only the range is checked.
    """
    network = network_saying((0.0, 0.0, 1.0), albedo, depth)
    maps = estimate_intrinsics(network, photograph(background))
    maps.check(SIZE, "background")
    flat = background not in ("checker", "red", "0", "1e-40", "3e38")
    wanted = np.full((*SIZE, 3), np.clip(albedo, 1e-3, 1.0)) if flat else maps.albedo
    return maps.albedo, wanted


CASES = [
    *(
        Case(
            f"estimated normals of {name}",
            "squares that are no float32, and a length of 0 to divide by",
            partial(_normal, name),
            absolute=1e-30,
        )
        for name in NORMALS
    ),
    *(
        Case(
            f"maps estimated of {background}, albedo {albedo:g}, depth {depth:g}",
            "shading is a quotient by albedo, in logarithms, followed along the picture's edges",
            partial(_maps, background, albedo, depth),
            relative=1e-4,
        )
        for background in BACKGROUNDS
        for albedo, depth in ((0.5, 1.0), (0.0, 0.0), (-1e30, -5.0), (1e30, 3e38))
    ),
]
