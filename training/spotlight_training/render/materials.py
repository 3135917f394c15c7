"""Draws materials: floors, walls, upholstery, wood, painted, glossy and metal surfaces."""

from __future__ import annotations

import colorsys

import numpy as np

from .description import Colour, Material

Rng = np.random.Generator

# Linear reflectance of the metals people recognise.
METALS: tuple[Colour, ...] = (
    (0.91, 0.92, 0.92),
    (0.95, 0.64, 0.54),
    (1.0, 0.78, 0.34),
    (0.56, 0.57, 0.58),
    (0.91, 0.78, 0.42),
    (0.54, 0.49, 0.45),
)
WOODS: tuple[Colour, ...] = (
    (0.45, 0.27, 0.13),
    (0.28, 0.15, 0.07),
    (0.12, 0.06, 0.03),
    (0.58, 0.40, 0.22),
    (0.38, 0.17, 0.08),
    (0.55, 0.47, 0.36),
)
GREYS: tuple[Colour, ...] = (
    (0.75, 0.73, 0.70),
    (0.45, 0.44, 0.43),
    (0.18, 0.18, 0.19),
    (0.60, 0.56, 0.50),
)

# Patterns with a repeat, and the metres one repeat covers, by what wears them.
FLOORS = {
    "planks": (0.09, 0.16),
    "tiles": (0.2, 0.5),
    "checker": (0.2, 0.5),
    "carpet": (0.3, 0.8),
    "marble": (0.6, 1.5),
    "concrete": (0.6, 1.5),
    "terrazzo": (0.2, 0.4),
    "bricks": (0.2, 0.3),
    "plain": (0.5, 1.0),
    "fabric": (0.2, 0.5),
    "wood": (0.4, 0.8),
    "patches": (0.5, 1.2),
    "stripes": (0.3, 0.8),
}
FLOOR_WEIGHTS = {
    "planks": 5.0,
    "carpet": 3.0,
    "tiles": 3.0,
    "concrete": 2.0,
    "plain": 2.0,
    "checker": 0.7,
    "stripes": 0.4,
}
WALLS = {
    "plaster": (0.8, 2.0),
    "plain": (1.0, 2.0),
    "bricks": (0.22, 0.3),
    "stripes": (0.3, 0.6),
    "planks": (0.12, 0.2),
    "tiles": (0.2, 0.4),
    "concrete": (0.8, 1.6),
    "dots": (0.25, 0.5),
}
WALL_WEIGHTS = {"plaster": 6.0, "plain": 3.0, "bricks": 1.5, "dots": 0.5}
OBJECTS = {
    "plain": (0.3, 0.6),
    "fabric": (0.1, 0.3),
    "wood": (0.15, 0.4),
    "marble": (0.2, 0.6),
    "stripes": (0.06, 0.2),
    "plaid": (0.1, 0.25),
    "dots": (0.06, 0.15),
    "checker": (0.06, 0.15),
    "patches": (0.15, 0.5),
    "terrazzo": (0.1, 0.3),
    "concrete": (0.2, 0.6),
    "plaster": (0.3, 0.8),
}
OBJECT_WEIGHTS = {"plain": 6.0, "fabric": 3.0, "wood": 2.5, "patches": 1.5}


def floor_material(rng: Rng) -> Material:
    """Draw a floor: mostly matt, sometimes polished."""
    pattern = _pick(rng, FLOORS, FLOOR_WEIGHTS)
    base = _wood(rng) if pattern in ("planks", "wood") else _muted(rng)
    polished = rng.random() < 0.15 and pattern not in ("carpet", "fabric")
    roughness = rng.uniform(0.2, 0.4) if polished else rng.uniform(0.5, 0.95)
    return _material(rng, pattern, FLOORS[pattern], base, roughness)


def wall_material(rng: Rng) -> Material:
    """Draw a wall: light more often than dark, always matt."""
    pattern = _pick(rng, WALLS, WALL_WEIGHTS)
    light = rng.random() < 0.7
    base = tuple(
        float(c) for c in np.clip(np.asarray(_muted(rng)) * (1.8 if light else 0.9), 0.04, 0.85)
    )
    return _material(rng, pattern, WALLS[pattern], base, rng.uniform(0.7, 1.0))


def object_materials(rng: Rng, metal_chance: float = 0.12) -> tuple[Material, ...]:
    """Draw the four material slots of an object.

    One palette in half of the cases, free colours in the rest.
    """
    palette = [_vivid(rng) if rng.random() < 0.55 else _muted(rng) for _ in range(4)]
    if rng.random() < 0.3:
        palette = [palette[0]] * 4
    return tuple(_object_material(rng, base, metal_chance) for base in palette)


def light_colour(rng: Rng) -> Colour:
    """Draw a dominant light's colour between warm and cool white, with mean 1."""
    warmth = rng.normal(0.0, 0.5)
    colour = np.array([1.0 + 0.18 * warmth, 1.0 + 0.02 * rng.normal(), 1.0 - 0.22 * warmth])
    colour = np.clip(colour, 0.55, 1.45)
    return _floats(colour / colour.mean())


def sky_colours(rng: Rng) -> tuple[Colour, Colour, Colour]:
    """Draw the zenith, horizon and ground colours of a gradient sky."""
    tint = rng.normal(0.0, 0.35)
    zenith = np.array([1.0 - 0.25 * abs(tint), 1.0, 1.0 + 0.25 * tint]) * rng.uniform(0.5, 1.2)
    horizon = np.array([1.0 + 0.15 * tint, 1.0, 1.0 - 0.1 * tint]) * rng.uniform(0.6, 1.3)
    ground = np.full(3, rng.uniform(0.1, 0.5))
    return _floats(zenith), _floats(horizon), _floats(ground)


def _object_material(rng: Rng, base: Colour, metal_chance: float) -> Material:
    draw = rng.random()
    if draw < metal_chance:
        pattern = "plain" if rng.random() < 0.7 else "patches"
        metal = METALS[rng.integers(len(METALS))]
        return _material(
            rng, pattern, (0.2, 0.5), metal, rng.uniform(0.18, 0.5), metallic=1.0, contrast=0.25
        )
    pattern = _pick(rng, OBJECTS, OBJECT_WEIGHTS)
    if pattern == "wood":
        base = _wood(rng)
    glossy = draw < 0.42 and pattern != "fabric"
    return _material(
        rng,
        pattern,
        OBJECTS[pattern],
        base,
        rng.uniform(0.15, 0.4) if glossy else rng.uniform(0.5, 1.0),
    )


def _material(
    rng: Rng,
    pattern: str,
    period: tuple[float, float],
    base: Colour,
    roughness: float,
    metallic: float = 0.0,
    contrast: float = 1.0,
) -> Material:
    """Complete a material.

    Two more colours are a darker or lighter relative of the base and a free accent.
    """
    relative = np.clip(
        np.asarray(base) * rng.uniform(0.35, 1.6) + rng.normal(0, 0.02, 3), 0.02, 0.92
    )
    accent = np.asarray(_muted(rng) if rng.random() < 0.6 else _vivid(rng))
    second = np.asarray(base) * (1 - contrast) + relative * contrast
    third = np.asarray(base) * (1 - contrast) + accent * contrast
    return Material(
        pattern=pattern,
        seed=int(rng.integers(2**31)),
        colours=(base, _floats(second), _floats(third)),
        period=float(rng.uniform(*period)),
        roughness=float(roughness),
        metallic=metallic,
    )


def _pick(rng: Rng, table: dict[str, tuple[float, float]], weights: dict[str, float]) -> str:
    names = list(table)
    weight = np.array([weights.get(name, 1.0) for name in names])
    return names[rng.choice(len(names), p=weight / weight.sum())]


def _wood(rng: Rng) -> Colour:
    return _floats(
        np.clip(np.asarray(WOODS[rng.integers(len(WOODS))]) * rng.uniform(0.75, 1.25), 0.02, 0.9)
    )


def _muted(rng: Rng) -> Colour:
    """Return a greyish or earthy colour."""
    grey = np.asarray(GREYS[rng.integers(len(GREYS))]) * rng.uniform(0.7, 1.1)
    hue = np.asarray(
        colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.1, 0.5), rng.uniform(0.15, 0.6))
    )
    return _floats(np.clip(grey if rng.random() < 0.5 else hue, 0.03, 0.85))


def _vivid(rng: Rng) -> Colour:
    return _floats(
        np.clip(
            colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.5, 0.95), rng.uniform(0.25, 0.8)),
            0.015,
            0.85,
        )
    )


def _floats(values: np.ndarray) -> Colour:
    r, g, b = (float(v) for v in values)
    return (r, g, b)
