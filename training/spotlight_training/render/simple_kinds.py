"""Object kinds made of one idea: primitives, extruded outlines and displaced spheres.

Every function takes a `numpy.random.Generator`, draws its own proportions from it and returns a
shape of any size; the caller scales it and stands it on the ground.
"""

from __future__ import annotations

import numpy as np

from .mesh import Array, Shape, flat
from .solids import (
    cylinder,
    displaced_sphere,
    ellipsoid,
    frustum,
    lathe,
    prism,
    rounded_box,
    sphere_directions,
    tube,
    turned,
)

Rng = np.random.Generator


def block(rng: Rng) -> Shape:
    """Return a rounded box, sometimes with a lid in a second material."""
    size = rng.uniform(0.45, 1.0, 3)
    body = rounded_box(size, rng.uniform(0.02, 0.25) * size.min())
    if rng.random() < 0.4:
        lid = size * [1.06, 1.06, 0.18]
        return body + rounded_box(lid, 0.3 * lid[2], (0, 0, size[2] / 2), slot=1)
    return body


def drum(rng: Rng) -> Shape:
    """Return an upright cylinder with rounded rims and one or two bands."""
    radius, height, rim = rng.uniform(0.2, 0.5), rng.uniform(0.4, 1.0), rng.uniform(0.01, 0.05)
    arc = np.linspace(0, np.pi / 2, 6)
    low = np.stack([radius - rim + rim * np.sin(arc), rim - rim * np.cos(arc)], 1)
    high = np.stack([radius - rim + rim * np.cos(arc), height - rim + rim * np.sin(arc)], 1)
    shape = lathe(np.concatenate([[[0.0, 0.0]], low, high, [[0.0, height]]]))
    for _ in range(rng.integers(0, 3)):
        z = rng.uniform(0.1, 0.8) * height
        shape += cylinder(radius * 1.03, 0.08 * height, (0, 0, z), slot=1, segments=40)
    return shape


def cone(rng: Rng) -> Shape:
    """Return a cone or frustum, sometimes on a flat square foot as a traffic cone has."""
    radius = rng.uniform(0.25, 0.5)
    top = rng.choice([0.02, 0.3]) * radius
    shape = frustum(radius, top, 1.0, segments=40)
    if rng.random() < 0.5:
        shape += rounded_box((2.5 * radius, 2.5 * radius, 0.06), 0.02, slot=1)
    return shape


def ring(rng: Rng) -> Shape:
    """Return a torus, lying, standing or leaning."""
    thick = rng.uniform(0.1, 0.22)
    turn = np.linspace(0, 2 * np.pi, 56, endpoint=False)
    path = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * 0.5
    return turned(tube(path, thick, closed=True, segments=24), "x", float(rng.choice([0, 90, 60])))


def knot(rng: Rng) -> Shape:
    """Return a torus knot tube."""
    p, q = ((2, 3), (3, 2), (2, 5), (3, 4))[rng.integers(4)]
    turn = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    radius = 0.5 + 0.2 * np.cos(q * turn)
    path = np.stack(
        [radius * np.cos(p * turn), radius * np.sin(p * turn), -0.25 * np.sin(q * turn)], 1
    )
    return turned(tube(path, rng.uniform(0.06, 0.1), closed=True, segments=12), "x", 90.0)


def capsule(rng: Rng) -> Shape:
    """Return a capsule, standing or lying."""
    radius, height = rng.uniform(0.18, 0.35), rng.uniform(0.2, 0.7)
    arc = np.linspace(0, np.pi / 2, 12)
    low = np.stack([radius * np.sin(arc), -radius * np.cos(arc)], 1)
    high = np.stack([radius * np.cos(arc), height + radius * np.sin(arc)], 1)
    shape = lathe(np.concatenate([low, high]))
    return turned(shape, "y", 90.0) if rng.random() < 0.35 else shape


def ball(rng: Rng) -> Shape:
    """Return a sphere or a slightly flattened one."""
    return ellipsoid((0.5, 0.5, 0.5 * rng.choice([1.0, 1.0, 0.7])), segments=48)


def crystal(rng: Rng) -> Shape:
    """Return a faceted convex solid: two fans over a many-sided belt."""
    sides = int(rng.integers(4, 9))
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    belts = [
        (rng.uniform(0.15, 0.4), 0.0),
        (0.5, rng.uniform(0.2, 0.5)),
        (rng.uniform(0.1, 0.3), 1.0),
    ]
    points = np.concatenate(
        [np.stack([r * np.cos(turn), r * np.sin(turn), 0 * turn + z], 1) for r, z in belts]
    )
    points = np.concatenate([points, [[0, 0, 0], [0, 0, 1.0]]])
    faces = []
    for i in range(sides):
        j = (i + 1) % sides
        for low in (0, sides):
            faces += [
                (low + i, low + j, low + sides + j),
                (low + i, low + sides + j, low + sides + i),
            ]
        faces += [(3 * sides, j, i), (3 * sides + 1, 2 * sides + i, 2 * sides + j)]
    return (flat(points, np.array(faces)),)


def star(rng: Rng) -> Shape:
    """Return an extruded star standing on two points."""
    points = int(rng.integers(5, 9))
    inner = rng.uniform(0.4, 0.7)
    return prism(
        _radial(points, lambda k: 0.5 * (1.0 if k % 2 else inner)),
        rng.uniform(0.15, 0.4),
        bevel=0.12,
    )


def gear(rng: Rng) -> Shape:
    """Return an extruded gear, upright or lying."""
    teeth = int(rng.integers(7, 14))
    depth = rng.uniform(0.72, 0.86)
    turn = np.arange(teeth * 4) * (2 * np.pi / (teeth * 4))
    radius = 0.5 * np.where(np.arange(teeth * 4) % 4 < 2, 1.0, depth)
    outline = np.stack([radius * np.cos(turn), radius * np.sin(turn)], 1)
    shape = prism(outline, rng.uniform(0.15, 0.35)) + turned(
        cylinder(0.16, 0.5, (0, 0, -0.25), slot=1), "x", 90.0
    )
    return turned(shape, "x", 90.0) if rng.random() < 0.4 else shape


def heart(rng: Rng) -> Shape:
    """Return an extruded heart."""
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    x = 16 * np.sin(turn) ** 3
    z = 13 * np.cos(turn) - 5 * np.cos(2 * turn) - 2 * np.cos(3 * turn) - np.cos(4 * turn)
    return prism(np.stack([-x, z], 1) / 32, rng.uniform(0.25, 0.5), bevel=0.15)


def wedge(rng: Rng) -> Shape:
    """Return an extruded L-shaped or ramp-shaped wedge."""
    a, b = rng.uniform(0.25, 0.5, 2)
    outline = (
        [(0, 0), (1, 0), (1, a), (b, a), (b, 0.9), (0, 0.9)]
        if rng.random() < 0.5
        else [(0, 0), (1, 0), (b, a + 0.4), (0, a + 0.4)]
    )
    return prism(np.array(outline), rng.uniform(0.4, 0.8), kernel=(0.1, 0.1))


def cross(rng: Rng) -> Shape:
    """Return an extruded plus sign."""
    arm = rng.uniform(0.12, 0.22)
    half = [(arm, -0.5), (arm, -arm), (0.5, -arm), (0.5, arm), (arm, arm), (arm, 0.5)]
    outline = np.array(half + [(-x, -z) for x, z in half])
    return prism(outline, rng.uniform(0.2, 0.4), bevel=0.08)


def arrow(rng: Rng) -> Shape:
    """Return an extruded upright arrow."""
    shaft, head = rng.uniform(0.1, 0.18), rng.uniform(0.3, 0.5)
    right = [(shaft, -0.5), (shaft, 0.5 - head), (0.36, 0.5 - head), (0.0, 0.5)]
    outline = np.array(right + [(-x, z) for x, z in right[-2::-1]])
    return prism(outline, rng.uniform(0.2, 0.4), kernel=(0.0, 0.52 - head))


def smooth_blob(rng: Rng) -> Shape:
    """Return a sphere pushed in and out by a few broad waves."""
    return displaced_sphere(_waves(rng, 6, 1.0, 2.5, 0.3), rng.uniform(0.7, 1.2, 3))


def lumpy_blob(rng: Rng) -> Shape:
    """Return a rock-like sphere with waves of several scales."""
    return displaced_sphere(
        _waves(rng, 8, 1.0, 3.0, 0.22) * _waves(rng, 16, 3.5, 8.0, 0.12), rng.uniform(0.7, 1.2, 3)
    )


def spiky_blob(rng: Rng) -> Shape:
    """Return a sphere with pointed bumps."""
    directions = sphere_directions(96, 65)
    tips = rng.normal(size=(int(rng.integers(9, 20)), 3))
    tips /= np.linalg.norm(tips, axis=1, keepdims=True)
    near = (directions @ tips.T).max(axis=-1)
    return displaced_sphere(0.6 + 0.5 * np.clip((near - 0.82) / 0.18, 0, 1) ** 1.5)


def ridged_blob(rng: Rng) -> Shape:
    """Return a pumpkin-like sphere with ridges from pole to pole, maybe twisted."""
    directions = sphere_directions(96, 49)
    turn = np.arctan2(directions[..., 1], directions[..., 0])
    ridges, twist = int(rng.integers(6, 13)), rng.uniform(-1.5, 1.5)
    depth = rng.uniform(0.06, 0.16) * np.sqrt(1 - directions[..., 2] ** 2)
    body = displaced_sphere(
        1.0 - depth * np.abs(np.sin(0.5 * ridges * (turn + twist * directions[..., 2]))),
        (1, 1, rng.uniform(0.65, 1.1)),
    )
    return body + frustum(0.12, 0.07, 0.35, (0, 0, 0.6), slot=1)


def _radial(points: int, radius: object) -> Array:
    """Return a star outline with one point down the middle of its feet, radii from `radius(k)`."""
    turn = np.pi / points * np.arange(2 * points) - np.pi / 2
    radii = np.array([radius(k) for k in range(2 * points)])  # type: ignore[operator]
    return np.stack([radii * np.cos(turn), radii * np.sin(turn)], 1)


def _waves(rng: Rng, count: int, low: float, high: float, amplitude: float) -> Array:
    """Return 1 + a sum of random plane waves over the sphere, shape (96, 65).

    Plane waves leave no seam or pole.
    """
    directions = sphere_directions(96, 65)
    total = np.zeros(directions.shape[:2])
    for _ in range(count):
        vector = rng.normal(size=3)
        vector *= rng.uniform(low, high) / np.linalg.norm(vector)
        total += np.sin(directions @ vector * np.pi / 2 + rng.uniform(0, 2 * np.pi))
    return 1.0 + amplitude * total / np.sqrt(count)
