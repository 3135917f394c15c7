"""From maps to conditioning: the shading quotient, depth alignment, compositing."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from oracle import conditioning as method

from spotlight_bench.stability_cases import mask_named
from spotlight_runtime.diffusion import conditioning
from spotlight_runtime.imaging.colour import encode_linear
from spotlight_spec import BACKBONES

from .case import Case, exact, planes

__all__ = ["CASES", "DEPTHS", "depth_named"]

SIZE = (24, 32)
SPEC = BACKBONES["zerocomp-openrooms"]
SHADING = next(entry for entry in SPEC.maps if entry.name == "shading")
SINGLE = 5e-7
"""A handful of float32 operations, powers among them."""
BACKGROUNDS = {
    "black": "0/0 where the albedo is black too",
    "white": "every pixel is at the end of its range",
    "red": "two channels are exactly 0",
    "checker": "the largest steps there are, at every pixel",
    "1e6": "HDR: far beyond what encodings are made for",
    "1e-40": "denormal radiance",
}
ALBEDOS = {"0": 0.0, "1": 1.0, "1e-7": 1e-7, "1e-40": 1e-40, "−1e-3": -1e-3}
DEPTHS = {
    "constant": "no slope to fit",
    "zero": "as where an estimator gives up",
    "inverted": "the background gets nearer where the object gets farther",
    "holes": "0 where nothing was seen, in one of three pixels",
    "far": "1e6 metres: small differences of large numbers",
}
FOOTPRINTS = {
    "of no pixel": "nothing to fit to",
    "of one pixel": "one equation, two unknowns",
    "of two pixels": "two equations, two unknowns: the fit is exact",
    "of two pixels alike": "two equations that are one",
    "that is collinear": "a contact parallel to the picture plane: any slope will do",
    "that is collinear but for rounding": "a slope made of rounding errors",
}
SLOPED = [("far", "of two pixels"), ("holes", "of two pixels")]
"""Where two pixels give a slope, and it is taken."""


def background_named(name: str) -> np.ndarray:
    """Linear radiance (H, W, 3)."""
    image = np.zeros((*SIZE, 3), np.float32)
    if name == "red":
        image[..., 0] = 0.5
    elif name == "checker":
        image[np.indices(SIZE).sum(axis=0) % 2 == 0] = 1.0
    elif name != "black":
        image[:] = 1.0 if name == "white" else float(name)
    return image


def depth_named(name: str, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Depth of a background (H, W), nearer towards the bottom unless it is inverted."""
    rows = np.linspace(1.0, 0.0, size[0], dtype=np.float32)[:, None]
    slope = np.broadcast_to(np.float32(2.0) + np.float32(4.0) * rows, size).copy()
    if name == "constant":
        return np.full(size, 3.0, np.float32)
    if name == "zero":
        return np.zeros(size, np.float32)
    if name == "inverted":
        return slope[::-1].copy()
    if name == "holes":
        slope[np.indices(size).sum(axis=0) % 3 == 0] = 0.0
    if name == "far":
        slope = slope + np.float32(1e6)
    return slope


def object_depth() -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied depth of a disc that bulges towards the camera, and its mask."""
    mask = mask_named("disc", SIZE)
    rows, columns = np.indices(SIZE)
    bulge = np.hypot(rows - SIZE[0] / 2, columns - SIZE[1] / 2) / SIZE[0]
    return (mask * (1.0 + bulge)).astype(np.float32), mask


def footprint_named(name: str) -> np.ndarray:
    """Contact depth (H, W), 0 where there is none."""
    foot = np.zeros(SIZE, np.float32)
    bottom = int(0.75 * SIZE[0])
    if name == "of one pixel":
        foot[bottom, 16] = 1.25
    elif name.startswith("of two pixels"):
        foot[bottom, 16] = 1.25
        foot[bottom + 1, 16] = 1.25 if name.endswith("alike") else 1.2
    elif name.startswith("that is collinear"):
        foot[bottom, 10:20] = 1.25
        if name.endswith("rounding"):
            foot[bottom, 10:20:2] = np.nextafter(np.float32(1.25), np.float32(2.0))
    return foot


def _shading(background: str, albedo: float, hidden: str) -> tuple[np.ndarray, np.ndarray]:
    encoded = encode_linear(background_named(background), SPEC.shading.background_encoding)
    flat = np.full((*SIZE, 3), albedo, np.float32)
    region = mask_named(hidden, SIZE) > 0.0
    expected = method.masked_shading(
        planes(encoded), planes(flat).clamp(min=0.0), torch.from_numpy(region)[None]
    )
    actual = conditioning.partial_shading(encoded, flat, region, SHADING, SPEC.shading.epsilon)
    return actual, expected.permute(1, 2, 0).numpy()


def _linear_shading(radiance: float) -> tuple[np.ndarray, np.ndarray]:
    """A backbone whose shading is a quotient of linear light, on black albedo."""
    image, black = np.full((*SIZE, 3), radiance, np.float32), np.zeros((*SIZE, 3), np.float32)
    seen = np.zeros(SIZE, bool)
    expected = method.masked_shading(planes(image), planes(black), torch.from_numpy(seen)[None])
    actual = conditioning.partial_shading(image, black, seen, SHADING, SPEC.shading.epsilon)
    return actual, expected.permute(1, 2, 0).numpy()


def _aligned(depth: str, foot: np.ndarray | None) -> np.ndarray:
    inserted, mask = object_depth()
    m, c = conditioning.align_depth(inserted, mask, depth_named(depth), foot)
    return m * inserted.astype(np.float64) + c * mask


def _fitted(depth: str, footprint: str) -> tuple[np.ndarray, np.ndarray]:
    foot = footprint_named(footprint)
    inserted, mask = object_depth()
    expected = method.aligned_to_footprint(
        planes(inserted), planes(mask), planes(foot), planes(foot) > 0.0, planes(depth_named(depth))
    )
    return _aligned(depth, foot), expected[0].numpy()


def _shifted_by_mean(depth: str, footprint: str) -> tuple[np.ndarray, np.ndarray]:
    """Where there is no slope: m = 1 and c the mean difference, as documented."""
    foot = footprint_named(footprint)
    inserted, mask = object_depth()
    touching = foot > 0.0
    shift = (depth_named(depth)[touching].astype(np.float64) - foot[touching]).mean()
    return _aligned(depth, foot), inserted.astype(np.float64) + shift * mask


def _nearest(depth: str, foot: bool) -> tuple[np.ndarray, np.ndarray]:
    inserted, mask = object_depth()
    expected = method.aligned_to_nearest(
        planes(inserted), planes(mask), planes(mask) > 0.5, planes(depth_named(depth))
    )
    empty = footprint_named("of no pixel") if foot else None
    return _aligned(depth, empty), expected[0].numpy()


def _hardly_there(cover: float) -> tuple[np.ndarray, np.ndarray]:
    """An object that covers next to nothing moves by as much, and by no infinity."""
    mask = np.full(SIZE, cover, np.float32)
    inserted = mask * np.float32(2.0)
    m, c = conditioning.align_depth(inserted, mask, depth_named("constant"))
    aligned = np.float32(m) * inserted + np.float32(c) * mask
    return conditioning.over(aligned, mask, depth_named("constant")), depth_named("constant")


def _not_premultiplied() -> tuple[np.ndarray, np.ndarray]:
    """A depth without cover, where premultiplied ones are 0, divided by a denormal cover."""
    mask = np.full(SIZE, 1e-42, np.float32)
    m, c = conditioning.align_depth(np.full(SIZE, 3.0, np.float32), mask, depth_named("constant"))
    return np.float64([m, c]), np.float64([1.0, 0.0])


def _region(shadow: str, covered: str) -> tuple[np.ndarray, np.ndarray]:
    m_shw, m_obj = mask_named(shadow, SIZE), mask_named(covered, SIZE)
    expected = method.masked_region(exact(m_shw)[None], exact(m_obj)[None])[0]
    return conditioning.masked_region(m_shw, m_obj), expected.numpy()


def _over(covered: str, scale: float) -> tuple[np.ndarray, np.ndarray]:
    cover = mask_named(covered, SIZE)
    behind = np.random.default_rng(0).random((*SIZE, 3), np.float32) * np.float32(scale)
    front = cover[..., None] * np.float32([1.0, 0.5, 0.0])
    expected = method.over(planes(front), planes(behind), planes(cover))
    return conditioning.over(front, cover, behind), expected.permute(1, 2, 0).numpy()


CASES = [
    *(
        Case(
            f"shading of a {background} background on albedo {albedo}, {hidden} hidden",
            why,
            partial(_shading, background, value, hidden),
            relative=SINGLE,
        )
        for background, why in BACKGROUNDS.items()
        for albedo, value in ALBEDOS.items()
        for hidden in ("empty", "disc", "full")
    ),
    *(
        Case(
            f"linear shading of radiance {radiance:g} on black",
            "a million times what float32 barely holds",
            partial(_linear_shading, radiance),
            relative=SINGLE,
        )
        for radiance in (0.0, 1e-40, 1e6, 3e38)
    ),
    *(
        Case(
            f"{depth} depth, footprint of two pixels",
            FOOTPRINTS["of two pixels"],
            partial(_fitted, depth, "of two pixels"),
            relative=1e-5,
        )
        for depth in ("far", "holes")
    ),
    *(
        Case(
            f"{depth} depth, footprint {footprint}",
            f"{DEPTHS[depth]}; {FOOTPRINTS[footprint]}",
            partial(_shifted_by_mean, depth, footprint),
            relative=SINGLE,
            absolute=SINGLE,
        )
        for depth in DEPTHS
        for footprint in FOOTPRINTS
        if footprint != "of no pixel" and (depth, footprint) not in SLOPED
    ),
    *(
        Case(
            f"{depth} depth, {'footprint of no pixel' if foot else 'no footprint'}",
            why,
            partial(_nearest, depth, foot),
            relative=SINGLE,
            absolute=SINGLE,
        )
        for depth, why in DEPTHS.items()
        for foot in (False, True)
    ),
    *(
        Case(
            f"depth of an object that covers {cover:g}",
            "to undo premultiplication is to divide by next to nothing",
            partial(_hardly_there, cover),
            relative=0.0,
            absolute=max(10.0 * cover, SINGLE),
        )
        for cover in (1e-3, 1e-20, 1e-40)
    ),
    Case(
        "depth that is not premultiplied under a denormal mask",
        "the quotient overflows, and what covers nothing has no depth: it is not moved",
        _not_premultiplied,
    ),
    *(
        Case(
            f"shading hidden by {shadow} beside {covered}",
            "thresholds at borders, on masks that are not binary",
            partial(_region, shadow, covered),
            relative=0.0,
        )
        for shadow in ("empty", "full", "pixel", "column", "soft", "border", "checker", "denormal")
        for covered in ("empty", "full", "pixel", "column", "disc", "denormal")
    ),
    *(
        Case(
            f"map composited over {scale:g} under {covered}",
            "(1 − α) of a soft edge, and of numbers of other sizes than the object's",
            partial(_over, covered, scale),
            relative=SINGLE,
        )
        for covered in ("empty", "full", "soft", "column", "denormal")
        for scale in (1.0, 1e6, 1e-40)
    ),
]
