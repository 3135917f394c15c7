"""From predictions to the picture: transfer curves, ratios, colour balance, layers, lights."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from oracle import composite as method
from oracle import factors as factor_method
from oracle import mixing as mixing_method

from spotlight_bench.stability_cases import mask_named
from spotlight_runtime import GuidingShadow
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.imaging import colour
from spotlight_runtime.imaging.upsampling import fit_guided
from spotlight_runtime.relighting import composite
from spotlight_runtime.relighting.canvas import Canvas
from spotlight_runtime.relighting.mixing import Mix
from spotlight_runtime.relighting.object_light import fit_light, light_rows

from .case import Case, Refusal, exact, planes

__all__ = ["CASES", "REFUSALS"]

SIZE = (24, 32)
SINGLE = 1e-6
"""A handful of float32 operations, powers among them."""
DENORMAL = 8.0 * 2.0**-149
"""What a handful of operations on denormals round by."""
FITTED = 2e-5
"""A fit's coefficients are float32, and of opposite signs."""
PICTURES = {
    "black": "0/0 in every ratio",
    "white": "the end of the range everywhere",
    "red": "two channels are exactly 0",
    "checker": "black beside white, at every pixel",
    "noise": "all there is",
    "1e-7": "below the ε of the ratio",
    "1e-40": "denormal",
}
MASKS = ("empty", "full", "pixel", "column", "disc", "soft", "border", "checker", "denormal")
CURVES = {
    "linear_to_gamma22": lambda x: x.clamp(0.0, 1.0) ** (1.0 / 2.2),
    "gamma22_to_linear": method.linear_light,
    "srgb_to_linear": method.linear_of_srgb,
    "linear_to_srgb": lambda x: method.displayed(x.clamp(0.0, 1.0) ** (1.0 / 2.2)),
}
VALUES = np.float32(
    [0.0, 1e-45, 1e-40, 1e-20, 1e-7, 0.0031308, 0.04045, 0.5, 1.0 - 2.0**-24, 1.0, 1.5, 1e6, 3e38]
)


def picture(name: str, seed: int = 0) -> np.ndarray:
    """Encoded pixels (H, W, 3) in [0, 1]."""
    image = np.zeros((*SIZE, 3), np.float32)
    if name == "noise":
        return np.random.default_rng(seed).random((*SIZE, 3), np.float32)
    if name == "red":
        image[..., 0] = 0.5
    elif name == "checker":
        image[np.indices(SIZE).sum(axis=0) % 2 == seed % 2] = 1.0
    elif name != "black":
        image[:] = 1.0 if name == "white" else float(name)
    return image


def _curve(name: str) -> tuple[np.ndarray, np.ndarray]:
    return getattr(colour, name)(VALUES), CURVES[name](exact(VALUES)).numpy()


def _ratio(predicted: str, no_shadow: str) -> tuple[np.ndarray, np.ndarray]:
    a, b = picture(predicted), picture(no_shadow, seed=1)
    expected = method.shadow_ratio(planes(a), planes(b))[0]
    return composite.shadow_ratio(a, b), expected.numpy()


def _limited(region: str) -> tuple[np.ndarray, np.ndarray]:
    hidden = mask_named(region, SIZE) > 0.5
    ratio = picture("noise")[..., 0]
    expected = method.region_ratio(exact(ratio)[None], exact(hidden)[None])[0]
    return composite.limit_to_region(ratio, hidden), expected.numpy()


def _balance(background: str, no_shadow: str, mask: str) -> tuple[np.ndarray, np.ndarray]:
    a, b, m = picture(background), picture(no_shadow, seed=1), mask_named(mask, SIZE)
    expected = method.colour_balance(planes(a), planes(b), planes(m))
    return composite.colour_balance(a, b, m), expected.flatten().numpy()


def _no_balance(background: str, no_shadow: str, mask: str) -> tuple[np.ndarray, np.ndarray]:
    """Documented: 1 where the prediction says nothing about colour."""
    a, b, m = picture(background), picture(no_shadow), mask_named(mask, SIZE)
    k = composite.colour_balance(a, b, m)
    return k[1:], np.ones(2)


def _composed(
    background: str, predicted: str, no_shadow: str, mask: str, region: str | None
) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = picture(background), picture(predicted, seed=1), picture(no_shadow, seed=2)
    m = mask_named(mask, SIZE)
    hidden = None if region is None else mask_named(region, SIZE) > 0.5
    image, untouched = composite.compose_picture(a, b, c, m, hidden)
    assert np.array_equal(image[untouched], a[untouched])
    expected = method.composited(
        planes(b), planes(c), planes(a), planes(m), None if hidden is None else planes(hidden)
    )
    return image, expected.clamp(0.0, 1.0).permute(1, 2, 0).numpy()


def _fit(values: str, weights: str, guide: str) -> tuple[np.ndarray, np.ndarray]:
    """A ratio image fitted to a guiding shadow, evaluated where it was fitted."""
    y, w, x = picture(values)[..., 0], mask_named(weights, SIZE), mask_named(guide, SIZE)
    fit = fit_guided(y, w, x[..., None], ridge=(1e-2, 0.0), usual=(0.0, 0.7))
    basis = torch.stack([exact(x), torch.ones(SIZE, dtype=torch.float64)])
    expected = factor_method.guided_fit(exact(y), exact(w), basis, [1e-2, 0.0], [0.0, 0.7])
    actual = fit.rows(x[..., None], 0, SIZE[0], SIZE, np.ones(SIZE, np.float32))
    return actual, factor_method.evaluated(expected, basis, SIZE).numpy()


def _smooth_fit(
    values: str, weights: str, guide: str, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """The same over cells, as for a renderer whose pixels are not believed one by one."""
    y, w, x = picture(values)[..., 0], mask_named(weights, SIZE), mask_named(guide, SIZE)
    fit = fit_guided(
        y, w, x[..., None], ridge=(1e-2, 0.0), usual=(0.0, 0.7), reach=reach, smooth=True
    )
    basis = torch.stack([exact(x), torch.ones(SIZE, dtype=torch.float64)])
    expected = factor_method.smooth_fit(exact(y), exact(w), basis, [1e-2, 0.0], [0.0, 0.7], reach)
    actual = fit.rows(x[..., None], 0, SIZE[0], SIZE, np.ones(SIZE, np.float32))
    return actual, factor_method.evaluated(expected, basis, SIZE).numpy()


def _object_light(
    albedo: float, mask: str, normal: str, reach: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    m = mask_named(mask, SIZE)
    straight = np.full((*SIZE, 3), albedo, np.float32)
    if normal == "noise":
        direction = np.random.default_rng(3).standard_normal((*SIZE, 3)).astype(np.float32)
        direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    else:
        direction = np.zeros((*SIZE, 3), np.float32)
        direction[..., 2] = float(normal)
    own = picture("noise", seed=4) * m[..., None]
    premultiplied = [each * m[..., None] for each in (straight, direction)]
    fits = fit_light(Canvas(np.zeros_like(own), m, *premultiplied), own, reach)
    actual = light_rows(fits, *premultiplied, m, 0, SIZE[0], SIZE)
    expected = factor_method.object_light(planes(own), *map(planes, premultiplied), exact(m), reach)
    n = factor_method.straight(planes(premultiplied[1]), exact(m))
    lit = []
    for (coefficients, least), colours in zip(expected, planes(premultiplied[0])):
        basis = torch.cat([factor_method.lambert_basis(colours, n), exact(m)[None]])
        lit.append(factor_method.evaluated(coefficients, basis, SIZE).clamp(min=least * colours))
    return actual, torch.stack(lit, -1).numpy()


def _guides(weights: list[float], colours: list[tuple[float, float, float]]) -> list[GuidingShadow]:
    return [
        GuidingShadow(np.full(SIZE, i / 10, np.float32), None, weight, tint)
        for i, (weight, tint) in enumerate(zip(weights, colours))
    ]


def _shares(
    weights: list[float], colours: list[tuple[float, float, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """ω does not depend on the unit of weights, so the oracle's are brought near one first."""
    of_one = exact(np.float64(weights)) / max(weights)
    expected = mixing_method.shares(of_one, exact(np.float64(colours)) / np.max(colours))
    return Mix.of(_guides(weights, colours)).shares, expected.numpy()


def _mixed(scale: float) -> tuple[np.ndarray, np.ndarray]:
    weights, colours = [1.0, 1e-6, 3.0], [(1.0, 0.0, 0.2), (1.0, 1.0, 1.0), (0.1, 1.0, 1e-6)]
    pictures = [picture("noise", seed) * np.float32(scale) for seed in range(3)]
    omega = mixing_method.shares(exact(np.float64(weights)), exact(np.float64(colours)))
    expected = mixing_method.mixed([planes(p) for p in pictures], omega)
    return Mix.of(_guides(weights, colours)).sum(pictures), expected.permute(1, 2, 0).numpy()


WHITE = (1.0, 1.0, 1.0)
CASES = [
    *(
        Case(
            f"{name} from 0 to 3e38",
            "a power of 0 and of denormals, a joint of two branches, and values to be clipped",
            partial(_curve, name),
            relative=SINGLE,
        )
        for name in CURVES
    ),
    *(
        Case(f"ratio of {a} to {b}", PICTURES[b], partial(_ratio, a, b), relative=SINGLE)
        for a in PICTURES
        for b in PICTURES
    ),
    *(
        Case(
            f"ratio limited to {region}",
            "a blur that meets the end of the picture, and must be exactly 0 away from the region",
            partial(_limited, region),
            relative=SINGLE,
        )
        for region in MASKS
    ),
    *(
        Case(
            f"colour balance of {a} to {b} around {mask}",
            PICTURES[b],
            partial(_balance, a, b, mask),
            relative=SINGLE,
            absolute=DENORMAL,
        )
        for a in PICTURES
        for b in ("white", "checker", "noise")
        for mask in MASKS
        if mask != "full"
    ),
    *(
        Case(
            f"no colour balance of {a} to {b} around {mask}",
            f"{PICTURES[b]}, to be divided by" if mask != "full" else "a mean over no pixels",
            partial(_no_balance, a, b, mask),
            relative=0.0,
        )
        for a in ("black", "white", "noise")
        for b, mask in (
            *((b, "disc") for b in ("black", "red", "1e-7", "1e-40")),
            ("noise", "full"),
        )
    ),
    *(
        Case(
            f"{a} picture of {b} over {c}, {mask}, {region}",
            f"{PICTURES[a]}; {PICTURES[c]}",
            partial(_composed, a, b, c, mask, region),
            absolute=1e-6,  # a tenth of a grey level in 16 bits, of what is black too
        )
        for a in ("black", "white", "red", "checker", "noise")
        for b, c in (("noise", "noise"), ("black", "white"), ("white", "checker"))
        for mask in ("empty", "pixel", "column", "disc", "soft")
        for region in (None, "empty", "full", "border")
        if (a, mask) != ("red", "soft")
    ),
    *(
        Case(
            f"fit of {values} to {guide} where {weights} counts",
            "a singular system but for its ridge, where the guide is constant or nothing is known",
            partial(_fit, values, weights, guide),
            relative=FITTED,
            absolute=1e-7,
        )
        for values in ("black", "checker", "noise", "1e-40")
        for weights in ("empty", "full", "pixel", "disc", "soft", "denormal")
        for guide in ("empty", "full", "column", "soft", "denormal")
    ),
    *(
        Case(
            f"smooth fit of {values} to {guide} where {weights} counts, over {reach:g}",
            "cells of which nothing is known, and pictures of a single cell",
            partial(_smooth_fit, values, weights, guide, reach),
            relative=FITTED,
            absolute=1e-7,
        )
        for values in ("black", "checker", "noise", "1e-40")
        for weights in ("empty", "full", "pixel", "soft", "denormal")
        for guide in ("empty", "column", "soft")
        for reach in (1.0, 5.0, 100.0)
    ),
    *(
        Case(
            f"smooth light of albedo {albedo:g} on {mask}, normals {normal}",
            "shading is a quotient by albedo and cover, fitted with five unknowns to few cells",
            partial(_object_light, albedo, mask, normal, 8.0),
            relative=5e-5,
            absolute=1e-6,
        )
        for albedo in (0.0, 1e-7, 0.5, 1.0)
        for mask in ("empty", "full", "pixel", "disc", "soft", "denormal")
        for normal in ("0", "noise")
    ),
    *(
        Case(
            f"light of albedo {albedo:g} on {mask}, normals {normal}",
            "shading is a quotient by albedo and cover, fitted with five unknowns",
            partial(_object_light, albedo, mask, normal),
            relative=5e-5,
            absolute=1e-6,
        )
        for albedo in (0.0, 1e-7, 0.5, 1.0)
        for mask in ("empty", "full", "pixel", "column", "disc", "soft", "denormal")
        for normal in ("0", "1", "noise")
    ),
    *(
        Case(
            f"shares of lights of {name}",
            "a quotient of sums that overflow or vanish unless weights are brought to one first",
            partial(_shares, weights, colours),
            relative=SINGLE,
        )
        for name, weights, colours in (
            ("equal weight", [1.0, 1.0], [WHITE, WHITE]),
            ("weights 1e-300", [1e-300, 3e-300], [WHITE, (0.5, 1.0, 1.0)]),
            ("denormal weights", [5e-324, 5e-324], [WHITE, WHITE]),
            ("denormal weights and colours", [5e-324, 1e-323], [(1e-9, 1e-9, 1e-9)] * 2),
            ("weights 1e308", [1e308, 1e308], [WHITE, WHITE]),
            ("weights and colours 1e200", [1e200, 1e200], [(1e200, 1e200, 1e200)] * 2),
            ("weights 1e-12 and 1e12", [1e-12, 1e12], [WHITE, WHITE]),
            ("weight 0 and 1", [0.0, 1.0], [WHITE, WHITE]),
        )
    ),
    *(
        Case(
            f"lights mixed, radiance {scale:g}",
            "small shares beside large ones, in float32",
            partial(_mixed, scale),
            relative=SINGLE,
            absolute=DENORMAL,
        )
        for scale in (1.0, 1e6, 1e-40)
    ),
]
REFUSALS = [
    Refusal(
        f"lights of {name}",
        "0/0 in every share",
        partial(Mix.of, _guides(weights, colours)),
        InvalidInputError,
        "lights: expected some light in every channel, got none in",
    )
    for name, weights, colours in (
        ("no weight", [0.0, 0.0], [WHITE, WHITE]),
        ("no blue", [1.0, 1.0], [(1.0, 1.0, 0.0), (1.0, 1.0, 0.0)]),
    )
]
