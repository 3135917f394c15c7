"""Lamps, plants and toys, drawn and oriented as `furniture` does.

Slot 0 is the body, slots 1 to 3 are shades, leaves, feet and the like.
"""

from __future__ import annotations

import numpy as np

from .mesh import Shape, transform_all
from .solids import (
    cylinder,
    ellipsoid,
    frustum,
    lathe,
    rod,
    rounded_box,
    surface,
    tube,
    turned,
)

Rng = np.random.Generator


def floor_lamp(rng: Rng) -> Shape:
    """Return a lamp with a foot, a pole and a shade (unlit)."""
    height, top, bottom = rng.uniform(0.9, 1.5), rng.uniform(0.1, 0.18), rng.uniform(0.16, 0.28)
    shade = rng.uniform(0.2, 0.32)
    wall = np.array(
        [
            [bottom, height - shade],
            [top, height],
            [top - 0.008, height],
            [bottom - 0.008, height - shade],
            [bottom, height - shade],
        ]
    )
    shape = lathe(wall, slot=1)
    shape += rod((0, 0, 0.02), (0, 0, height - 0.03), 0.014) + frustum(0.16, 0.14, 0.03)
    return shape + ellipsoid((0.04, 0.04, 0.055), (0, 0, height - 0.6 * shade), slot=2, segments=16)


def desk_lamp(rng: Rng) -> Shape:
    """Return an arm lamp with a conical head."""
    low, high = rng.uniform(0.25, 0.4), rng.uniform(0.25, 0.4)
    elbow = np.array([-0.12, 0, 0.03 + low])
    tip = elbow + high * np.array([np.cos(0.5), 0, np.sin(0.5)])
    shape = (
        cylinder(0.12, 0.03, slot=1, segments=36)
        + rod((0, 0, 0.02), elbow, 0.012)
        + rod(elbow, tip, 0.012)
    )
    shape += ellipsoid((0.022, 0.022, 0.022), elbow, slot=1, segments=16)
    wall = np.array([[0.03, 0.0], [0.11, -0.13], [0.105, -0.13], [0.025, -0.005], [0.03, 0.0]])[
        ::-1
    ]
    head = turned(lathe(wall, slot=1), "y", float(rng.uniform(-30, 20)))
    return shape + transform_all(head, offset=tip)


def plant(rng: Rng) -> Shape:
    """Return a potted plant with arching leaves."""
    pot = rng.uniform(0.12, 0.18)
    shape = frustum(pot * 0.7, pot, 0.22, segments=36) + cylinder(
        pot * 0.9, 0.02, (0, 0, 0.205), slot=2
    )
    for _ in range(int(rng.integers(9, 18))):
        turn, length, rise = rng.uniform(0, 360), rng.uniform(0.2, 0.45), rng.uniform(0.15, 0.5)
        width = rng.uniform(0.03, 0.06)
        t = np.linspace(0, 1, 9)
        spine = np.stack([length * t, 0 * t, 0.21 + rise * np.sin(np.pi * 0.75 * t)], 1)
        across = width * np.sin(np.pi * np.clip(t * 0.95 + 0.04, 0, 1))
        blade = np.stack([np.clip(np.abs(across) * 0.12, 0.002, None), across], 1)
        leaf = tube(spine, 1.0, closed=False, slot=1, segments=8)
        shape += turned(_flatten(leaf, spine, blade), "z", turn)
    return shape


def bear(rng: Rng) -> Shape:
    """Return a sitting toy bear of ellipsoids."""
    belly, head = rng.uniform(0.2, 0.26), rng.uniform(0.15, 0.2)
    top = 1.9 * belly + head * 0.7
    shape = ellipsoid((belly, belly * 0.9, belly * 1.15), (0, 0, belly * 1.1), segments=32)
    shape += ellipsoid((head, head * 0.9, head * 0.9), (0, -0.02, top), segments=32)
    shape += ellipsoid(
        (head * 0.4, head * 0.35, head * 0.3), (0, -0.02 - head * 0.85, top - 0.1 * head), slot=1
    )
    shape += ellipsoid((0.025, 0.02, 0.02), (0, -0.02 - head * 1.2, top), slot=2, segments=12)
    for side in (-1, 1):
        shape += ellipsoid(
            (head * 0.38, head * 0.2, head * 0.38), (side * head * 0.75, 0, top + head * 0.7)
        )
        shape += ellipsoid(
            (0.02, 0.015, 0.02),
            (side * head * 0.35, -0.02 - head * 0.85, top + head * 0.2),
            slot=2,
            segments=12,
        )
        shape += ellipsoid(
            (belly * 0.38, belly * 0.8, belly * 0.4),
            (side * belly * 0.8, -belly * 0.8, belly * 0.4),
        )
        shape += ellipsoid(
            (belly * 0.75, belly * 0.3, belly * 0.3),
            (side * belly * 1.15, -belly * 0.2, belly * 1.5),
        )
    return shape


def stack(rng: Rng) -> Shape:
    """Return a small pile of boxes and cylinders, each turned a little."""
    z, shape, width = 0.0, (), 0.5
    for level in range(int(rng.integers(2, 5))):
        height = rng.uniform(0.12, 0.35)
        if rng.random() < 0.35:
            piece = cylinder(width / 2, height, segments=36, slot=level % 4)
        else:
            piece = rounded_box(
                (width, width * rng.uniform(0.7, 1.0), height),
                0.02,
                (0, 0, height / 2),
                slot=level % 4,
            )
        shape += transform_all(
            turned(piece, "z", rng.uniform(0, 90)), offset=(*rng.uniform(-0.03, 0.03, 2), z)
        )
        z, width = z + height, width * rng.uniform(0.65, 0.95)
    return shape


def _flatten(leaf: Shape, spine: np.ndarray, blade: np.ndarray) -> Shape:
    """Scale each ring of a unit tube to a blade's half thickness (up) and half width (y)."""
    skin = leaf[0]
    count = len(spine)
    rings = skin.vertices.reshape(-1, count, 3)
    side = rings - spine
    flat_rings = spine + np.stack(
        [0 * side[..., 0], side[..., 1] * blade[:, 1], np.zeros_like(side[..., 0])], -1
    )
    flat_rings[..., 2] += side[..., 2] * blade[:, 0]
    return (surface(flat_rings[:-1], close_u=True, slot=1),)
