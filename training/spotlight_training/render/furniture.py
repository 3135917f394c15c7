"""Seats, tables and storage: the object kinds closest to what people insert into photographs.

Every function draws its own proportions from the generator it is given, in metres, standing on
z = 0 and facing the camera (-y). Slot 0 is the body, slots 1 to 3 are cushions, legs, handles.
"""

from __future__ import annotations

import numpy as np

from .mesh import Shape, transform_all
from .solids import (
    beam,
    box,
    cylinder,
    ellipsoid,
    frustum,
    lathe,
    rod,
    rounded_box,
    tube,
    turned,
)

Rng = np.random.Generator


def chair(rng: Rng) -> Shape:
    """Return a four-legged chair with a slatted, solid or padded back."""
    width, depth = rng.uniform(0.4, 0.52, 2)
    seat, back = rng.uniform(0.42, 0.5), rng.uniform(0.38, 0.55)
    shape = legs(rng, width, depth, seat, slot=2)
    shape += rounded_box((width, depth, 0.05), 0.02, (0, 0, seat), slot=1)
    lean = rng.uniform(0.02, 0.1)
    for side in (-1, 1):
        x = side * (width / 2 - 0.03)
        shape += rod(
            (x, depth / 2 - 0.03, seat), (x, depth / 2 - 0.03 + lean, seat + back), 0.018, slot=2
        )
    style = rng.integers(3)
    rows = (0.35, 0.6, 0.85) if style == 0 else (0.6,)
    for row in rows:
        y, height = depth / 2 - 0.03 + lean * row, 0.08 if style == 0 else back * 0.6
        shape += rounded_box(
            (width - 0.04, 0.03, height),
            0.012,
            (0, y, seat + back * row),
            slot=1 if style == 2 else 0,
        )
    return shape


def armchair(rng: Rng) -> Shape:
    """Return an upholstered armchair."""
    return _upholstered(rng, rng.uniform(0.72, 0.95), seats=1)


def sofa(rng: Rng) -> Shape:
    """Return a two- or three-seat sofa."""
    seats = int(rng.integers(2, 4))
    return _upholstered(rng, 0.5 + 0.55 * seats, seats)


def bench(rng: Rng) -> Shape:
    """Return a slatted park bench, with or without a back."""
    width, depth, seat = rng.uniform(0.9, 1.5), rng.uniform(0.35, 0.45), rng.uniform(0.4, 0.48)
    shape: Shape = ()
    slats = int(rng.integers(3, 6))
    pitch = depth / slats
    for i in range(slats):
        shape += rounded_box(
            (width, pitch * 0.75, 0.03), 0.01, (0, -depth / 2 + (i + 0.5) * pitch, seat)
        )
    for x in (-0.38 * width, 0.38 * width):
        shape += box((0.06, depth * 0.9, 0.04), (x, 0, seat - 0.035), slot=1)
        shape += box((0.05, 0.05, seat - 0.04), (x, -depth * 0.38, (seat - 0.04) / 2), slot=1)
        shape += box((0.05, 0.05, seat - 0.04), (x, depth * 0.38, (seat - 0.04) / 2), slot=1)
    if rng.random() < 0.6:
        for z in (0.15, 0.27, 0.39):
            shape += rounded_box((width, 0.03, 0.09), 0.01, (0, depth / 2 + 0.15 * z, seat + z))
        for x in (-0.38 * width, 0.38 * width):
            shape += beam(
                (x, depth / 2 + 0.02, seat - 0.03),
                (x, depth / 2 + 0.09, seat + 0.42),
                0.04,
                0.03,
                slot=1,
            )
    return shape


def table(rng: Rng) -> Shape:
    """Return a rectangular or round four-legged table."""
    width, depth, height = rng.uniform(0.6, 1.2), rng.uniform(0.5, 0.8), rng.uniform(0.4, 0.75)
    if rng.random() < 0.4:
        shape = legs(rng, 0.75 * width, 0.75 * width, height, slot=1)
        return shape + cylinder(width / 2, 0.035, (0, 0, height), segments=48)
    shape = legs(rng, width * 0.92, depth * 0.92, height, slot=1)
    shape += box((width * 0.85, depth * 0.85, 0.07), (0, 0, height - 0.045), slot=1)
    return shape + rounded_box((width, depth, 0.04), 0.012, (0, 0, height))


def pedestal_table(rng: Rng) -> Shape:
    """Return a round table on one turned column with a foot plate or three feet."""
    radius, height = rng.uniform(0.25, 0.45), rng.uniform(0.5, 0.8)
    shape = cylinder(radius, 0.035, (0, 0, height - 0.035), segments=48)
    column = np.array(
        [[0, 0.03], [0.05, 0.03], [0.035, 0.2], [0.06, 0.45], [0.03, 0.7], [0.06, 1.0], [0, 1.0]]
    )
    shape += lathe(column * [1, height - 0.04], slot=1, crease=60.0)
    if rng.random() < 0.5:
        return shape + frustum(radius * 0.65, radius * 0.5, 0.04, slot=1, segments=40)
    for turn in (90, 210, 330):
        shape += turned(
            beam((0.02, 0, 0.16), (radius * 0.8, 0, 0.02), 0.04, 0.04, slot=1), "z", turn
        )
    return shape


def stool(rng: Rng) -> Shape:
    """Return a stool with a round or square seat and splayed legs."""
    radius, height = rng.uniform(0.15, 0.22), rng.uniform(0.4, 0.72)
    splay, count = rng.uniform(1.0, 1.35), int(rng.integers(3, 5))
    square = rng.random() < 0.3
    if square:
        shape = rounded_box((2 * radius, 2 * radius, 0.05), 0.02, (0, 0, height))
    else:
        shape = cylinder(radius, 0.05, (0, 0, height - 0.025), segments=40)
    offset = 45.0 if square else 0.0
    for i in range(count):
        turn = np.deg2rad(offset + 360 * i / count)
        direction = np.array([np.cos(turn), np.sin(turn), 0]) * radius
        shape += rod(direction * splay, direction * 0.8 + [0, 0, height], 0.018, slot=1)
    if rng.random() < 0.6:
        rail = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        path = (
            np.stack([np.cos(rail), np.sin(rail), 0 * rail], 1) * radius * (0.4 * 0.8 + 0.6 * splay)
        )
        shape += tube(path + np.array([0, 0, 0.4 * height]), 0.011, closed=True, slot=1, segments=8)
    return shape


def shelf(rng: Rng) -> Shape:
    """Return an open shelf with boards and some books."""
    width, depth, height = rng.uniform(0.5, 0.9), rng.uniform(0.22, 0.35), rng.uniform(0.8, 1.5)
    boards = int(rng.integers(3, 6))
    shape: Shape = ()
    for side in (-1, 1):
        shape += box((0.025, depth, height), (side * width / 2, 0, height / 2))
    if rng.random() < 0.6:
        shape += box((width, 0.012, height - 0.01), (0, depth / 2, height / 2))
    gap = (height - 0.04) / (boards - 1)
    for i in range(boards):
        shape += box((width, depth, 0.022), (0, 0, 0.02 + i * gap))
    for i in range(boards - 1):
        x = -width / 2 + 0.03
        while x < width / 2 - 0.12 and rng.random() < 0.9:
            thick, tall = rng.uniform(0.02, 0.06), gap * rng.uniform(0.5, 0.85)
            shape += box(
                (thick * 0.95, depth * 0.7, tall),
                (x + thick / 2, 0, 0.032 + i * gap + tall / 2),
                slot=int(rng.integers(1, 4)),
            )
            x += thick
    return shape


def cabinet(rng: Rng) -> Shape:
    """Return a chest of drawers or a two-door cabinet with knobs."""
    width, depth, height = rng.uniform(0.45, 1.0), rng.uniform(0.35, 0.5), rng.uniform(0.5, 1.0)
    foot = rng.uniform(0.04, 0.16)
    shape = legs(rng, width * 0.92, depth * 0.9, foot + 0.01, slot=2)
    shape += box((width, depth, height), (0, 0, foot + height / 2))
    shape += rounded_box((width * 1.04, depth * 1.06, 0.035), 0.01, (0, 0, foot + height + 0.01))
    columns, rows = (
        (2, 1) if rng.random() < 0.35 else (int(rng.integers(1, 3)), int(rng.integers(2, 5)))
    )
    for column in range(columns):
        for row in range(rows):
            w, h = width / columns, height / rows
            x, z = -width / 2 + (column + 0.5) * w, foot + (row + 0.5) * h
            shape += rounded_box((w * 0.9, 0.03, h * 0.88), 0.008, (x, -depth / 2, z), slot=1)
            shape += ellipsoid((0.016, 0.02, 0.016), (x, -depth / 2 - 0.03, z), slot=2, segments=16)
    return shape


def legs(rng: Rng, width: float, depth: float, height: float, slot: int) -> Shape:
    """Return four legs, round, square or tapered, under a rectangle."""
    style, thick = rng.integers(3), rng.uniform(0.014, 0.03)
    shape: Shape = ()
    for x in (-width / 2 + thick, width / 2 - thick):
        for y in (-depth / 2 + thick, depth / 2 - thick):
            if style == 0:
                shape += box((2 * thick, 2 * thick, height), (x, y, height / 2), slot)
            else:
                shape += frustum(
                    thick * (1.0 if style == 1 else 0.6),
                    thick,
                    height,
                    (x, y, 0),
                    slot,
                    segments=14,
                )
    return shape


def _upholstered(rng: Rng, width: float, seats: int) -> Shape:
    depth, seat, back, arm = (
        rng.uniform(0.7, 0.9),
        rng.uniform(0.3, 0.36),
        rng.uniform(0.4, 0.55),
        rng.uniform(0.1, 0.2),
    )
    foot, soft = rng.uniform(0.05, 0.14), rng.uniform(0.03, 0.07)
    inner = width - 2 * arm
    shape = legs(rng, width * 0.9, depth * 0.85, foot + 0.02, slot=2)
    shape += rounded_box(
        (width, depth, seat - foot - 0.08), soft * 0.6, (0, 0, (foot + seat - 0.08) / 2)
    )
    shape += rounded_box(
        (width, 0.22, back + seat - foot), soft, (0, depth / 2 - 0.11, (foot + back + seat) / 2)
    )
    for side in (-1, 1):
        x, tall = side * (width / 2 - arm / 2), seat - foot + rng.uniform(0.16, 0.17)
        shape += rounded_box((arm, depth, tall), soft, (x, 0, foot + tall / 2))
    each = inner / seats
    for i in range(seats):
        x = -inner / 2 + (i + 0.5) * each
        shape += rounded_box(
            (each * 0.98, depth - 0.2, 0.14), 0.05, (x, -0.09, seat - 0.02), slot=1
        )
        cushion = rounded_box((each * 0.94, 0.15, back * 0.8), 0.06, (0, 0, 0), slot=1)
        shape += transform_all(
            turned(cushion, "x", -10.0), offset=(x, depth / 2 - 0.28, seat + 0.05 + back * 0.42)
        )
    if rng.random() < 0.4:
        pillow = turned(ellipsoid((0.19, 0.07, 0.19), slot=3), "x", -25.0)
        shape += transform_all(
            pillow, offset=(rng.uniform(-0.3, 0.3) * inner, depth / 2 - 0.4, seat + 0.22)
        )
    return shape
