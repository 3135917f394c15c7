"""Whole relights with a tiny backbone: finite, in range, and the photograph where nothing falls."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from oracle import composite as method
from oracle.conditioning import gamma_encoded
from support.onnx_backbone import write_backbone
from support.scenes import make_scene, make_shadow
from support.shadow_scenes import ball_scene

from spotlight_bench.stability_cases import mask_named
from spotlight_runtime import Intrinsics, Light, Relighter, Scene
from spotlight_runtime.diffusion.noise import MAX_SEED
from spotlight_runtime.errors import InvalidInputError, NonFiniteError, ShadowWarning

from .case import Case, Refusal, planes
from .map_cases import DEPTHS, depth_named

__all__ = ["CASES", "REFUSALS", "tiny_relighter"]

SIZE = (64, 96)
LARGER = (160, 200)
"""Than the tiny backbone was made for: it sees a window, shrunk."""
DETAILS = ("renderer", "maps")
REACH = 17
"""Pixels a shadow's soft border may reach beyond it, at the photograph's scale."""
SINGLE = 3e-6


@cache
def tiny_relighter() -> Relighter:
    """Random weights, four steps; its files are read when it is first used."""
    with tempfile.TemporaryDirectory() as folder:
        relighter = Relighter.load(write_backbone(Path(folder) / "tiny"), threads=1, remember=0)
        for graph in relighter._networks:
            relighter._networks[graph]
    return relighter


def relit(scene: Scene, guide: Any = None, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """The picture away from object and shadow, and what the oracle shows of the photograph.

    The public release may darken it everywhere, so of its reading only range is checked.
    """
    shadow = make_shadow(scene) if guide is None else guide
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ShadowWarning)  # hard depths hide most shadows
        result = tiny_relighter().relight(scene, shadow, denoise=False, **options)
    for each in (result.image, result.prediction, result.no_shadow):
        assert np.isfinite(each).all()
        assert each.min() >= 0.0
        assert each.max() <= 1.0
    assert result.image.shape == (*scene.size, 3)
    near = (scene.object_mask > 0.0) | (result.guides[0].positive > 0.0)
    reach = np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)
    far = cv2.dilate(near.astype(np.uint8), reach) == 0
    far &= options.get("fidelity") != "release"
    shown = method.displayed(gamma_encoded(planes(scene.background))).permute(1, 2, 0).numpy()
    return result.image[far], shown[far]


def with_mask(name: str, size: tuple[int, int] = SIZE) -> Scene:
    """The scene with another object mask, everything else premultiplied by it."""
    mask = mask_named(name, size)
    cover = mask[..., None]
    maps = Intrinsics(
        albedo=cover * np.float32([0.7, 0.3, 0.2]),
        normal=cover * np.float32([0.0, 0.0, 1.0]),
        depth=mask * np.float32(2.5),
        roughness=mask * np.float32(0.4),
        metallic=mask * np.float32(0.1),
    )
    return replace(make_scene(*size), object_mask=mask, object_maps=maps, footprint_depth=None)


def with_mask_beside_its_range(hair: float) -> Scene:
    """Coverage that is a hair below 0 where there is no object, and above 1 inside it."""
    scene = make_scene(*SIZE)
    mask = scene.object_mask
    beside = np.where(mask == 0.0, -hair, np.where(mask == 1.0, 1.0 + hair, mask))
    return replace(scene, object_mask=beside.astype(np.float32))


def with_background(value: str, size: tuple[int, int]) -> Scene:
    scene = make_scene(*size)
    image = np.zeros_like(scene.background)
    if value == "checker":
        image[np.indices(size).sum(axis=0) % 2 == 0] = 1.0
    elif value == "red":
        image[..., 0] = 0.5
    else:
        image[:] = float(value)
    return replace(scene, background=image)


def with_albedo(value: float) -> Scene:
    scene = make_scene(*LARGER)
    flat = np.full_like(scene.background, value)
    return replace(
        scene,
        background_maps=replace(scene.background_maps, albedo=flat),
        object_maps=replace(scene.object_maps, albedo=flat * scene.object_mask[..., None]),
    )


def with_depth(name: str, footprint: bool) -> Scene:
    scene = make_scene(*LARGER)
    maps = replace(scene.background_maps, depth=depth_named(name, LARGER))
    foot = scene.footprint_depth if footprint else None
    return replace(scene, background_maps=maps, footprint_depth=foot)


def with_depth_and_mesh(name: str) -> Scene:
    scene = ball_scene(96)
    depth = np.full(scene.size, 1e-40, np.float32) if name == "denormal" else None
    depth = depth_named(name, scene.size) if depth is None else depth
    maps = replace(scene.background_maps, depth=depth)
    inserted = replace(scene.object_maps, normal=np.zeros_like(scene.background))
    return replace(scene, background_maps=maps, object_maps=inserted)


def _case(name: str, why: str, build: Callable[[], Any], full: bool = False) -> Case:
    return Case(name, why, build, relative=SINGLE, full=full)


CASES = [
    *(
        _case(
            f"relight of {height}×{width}, detail of the {detail}",
            "filters larger than the picture, borders grown to what networks take, odd latents",
            lambda height=height, width=width, detail=detail: relit(
                make_scene(height, width), detail=detail
            ),
        )
        for height, width in (
            (1, 1),
            (3, 5),
            (8, 8),
            (7, 130),
            (16, 128),
            (128, 16),
            (51, 45),
            (300, 37),
            (512, 512),
        )
        for detail in DETAILS
    ),
    *(
        _case(
            f"relight of 2048×2048, window {window}",
            "sixty-five thousand latents, or a window that is enlarged",
            lambda window=window: relit(make_scene(2048, 2048), window=window),
            full=True,
        )
        for window in ("auto", "frame")
    ),
    *(
        _case(
            f"relight of an object that is {mask}, detail of the {detail}, window {window}",
            "nothing to guide, nothing to keep, or next to nothing to fit to",
            lambda mask=mask, detail=detail, window=window: relit(
                with_mask(mask), detail=detail, window=window
            ),
        )
        for mask in ("empty", "full", "pixel", "column", "soft", "border", "checker", "denormal")
        for detail, window in (("renderer", "auto"), ("maps", "auto"), ("maps", "tight"))
    ),
    *(
        _case(
            f"relight of a mask {hair:g} beside its range, detail of the {detail}",
            "filters leave as much, and the photograph shows through 1 − α",
            lambda hair=hair, detail=detail: relit(
                with_mask_beside_its_range(hair), detail=detail, window="tight"
            ),
        )
        for hair in (1e-8, 9e-4)
        for detail in DETAILS
    ),
    *(
        _case(
            f"relight by a shadow that is {shadow}, detail of the {detail}",
            "no shadow, nothing but shadow, at the border, under the object",
            lambda shadow=shadow, detail=detail: relit(
                make_scene(*SIZE), mask_named(shadow, SIZE), detail=detail, window="tight"
            ),
        )
        for shadow in ("empty", "full", "pixel", "column", "border", "disc", "checker", "denormal")
        for detail in DETAILS
    ),
    *(
        _case(
            f"relight on a background of {value}, {size[0]}×{size[1]}, detail of the {detail}",
            "black, white, one colour, the largest contrast, HDR, denormal: every quotient of it",
            lambda value=value, size=size, detail=detail: relit(
                with_background(value, size), detail=detail
            ),
        )
        for value in ("0", "1", "red", "checker", "1e6", "1e-40", "3e38")
        for size in (SIZE, LARGER)
        for detail in DETAILS
    ),
    *(
        _case(
            f"relight on albedo {albedo:g}, detail of the {detail}",
            "what shading is divided by",
            lambda albedo=albedo, detail=detail: relit(with_albedo(albedo), detail=detail),
        )
        for albedo in (0.0, 1.0)
        for detail in DETAILS
    ),
    *(
        _case(
            f"relight with {depth} depth{'' if footprint else ', no footprint'}",
            why,
            lambda depth=depth, footprint=footprint: relit(with_depth(depth, footprint)),
        )
        for depth, why in DEPTHS.items()
        for footprint in (True, False)
    ),
    *(
        _case(
            f"relight by a light on {depth} depth, {frame} frame",
            f"{why}; the shadow falls on what it says",
            lambda depth=depth, frame=frame: relit(
                with_depth_and_mesh(depth), Light(azimuth=135, elevation=50, frame=frame)
            ),
        )
        for depth, why in (DEPTHS | {"denormal": "1/depth is infinite"}).items()
        for frame in ("world", "camera")
    ),
    *(
        _case(
            f"relight by a light at {', '.join(f'{k} {v}' for k, v in place.items())}",
            "an end of where a light may be, or of its size",
            lambda place=place: relit(
                with_depth_and_mesh("constant"),
                Light(**({"azimuth": 135, "elevation": 50} | place)),
            ),
        )
        for place in (
            {"elevation": 90},
            {"elevation": 1e-6},
            {"azimuth": 1e18},
            {"distance": 1e9},
            {"distance": None, "radius": 60},
            {"radius": 0},
            {"radius": 1e-300},
        )
    ),
    *(
        _case(
            f"relight at {', '.join(f'{k} {v}' for k, v in options.items())}",
            "an end of what options allow",
            lambda options=options: relit(make_scene(*SIZE), **options),
        )
        for options in (
            {"gamma": 0.0},
            {"gamma": 15.0},
            {"beta": 1.0},
            {"beta": 1.0, "fidelity": "release"},
            {"gamma": 15.0, "guidance_rescale": 1.0},
            {"seed": 0},
            {"seed": MAX_SEED},
            {"shadow_opacity": 0.0},
            *(
                {"solver": solver, "steps": steps}
                for solver in ("ddim", "dpmpp_2m", "unipc")
                for steps in (1, 2, 3, 50)
            ),
        )
    ),
    _case(
        "relight at steps 1000",
        "every train step",
        lambda: relit(make_scene(*SIZE), steps=1000),
        full=True,
    ),
]


def _spoiled(name: str, value: float) -> Scene:
    """The scene with one value of one of its arrays replaced."""
    scene = make_scene(*SIZE)
    owner, _, field = name.rpartition(" ")
    maps = getattr(scene, f"{owner}_maps") if owner else scene
    array = getattr(maps, field).copy()
    array[3, 4] = value
    changed = replace(maps, **{field: array})
    return replace(scene, **{f"{owner}_maps": changed}) if owner else changed


def _shadow(value: float) -> np.ndarray:
    shadow = make_shadow(make_scene(*SIZE))
    shadow[3, 4] = value
    return shadow


REFUSALS = [
    *(
        Refusal(
            f"{value} in {name}",
            "one value that is not finite spoils all it is filtered with",
            partial(_spoiled, name, value),
            NonFiniteError,
            rf"{name}: \d of \d+ values are NaN or infinite",
        )
        for name in (
            "background",
            "object_mask",
            "footprint_depth",
            "background albedo",
            "background normal",
            "background depth",
            "object albedo",
            "object depth",
        )
        for value in (np.nan, np.inf)
    ),
    *(
        Refusal(
            f"{value} in the shadow",
            "likewise, of what is drawn",
            lambda value=value: relit(make_scene(*SIZE), _shadow(value)),
            error,
            message,
        )
        for value, error, message in (
            (np.nan, NonFiniteError, "shadow: 1 of 6144 values are NaN or infinite"),
            (np.inf, NonFiniteError, "shadow: 1 of 6144 values are NaN or infinite"),
            (2.0, InvalidInputError, r"shadow: expected values in \[0, 1\]"),
        )
    ),
    *(
        Refusal(
            f"light of {name} {value}",
            "its square is no float32, and it is as good as infinitely far",
            partial(Light, **(place | {name: value})),
            InvalidInputError,
            f"{name}: expected a finite number .* got {number}",
        )
        for place, name, value, number in (
            ({"azimuth": 0.0, "elevation": 45.0}, "distance", 1e30, r"1e\+30"),
            ({"azimuth": 0.0, "elevation": 45.0}, "distance", np.inf, "inf"),
            ({"azimuth": 0.0, "elevation": 45.0}, "radius", 1e300, r"1e\+300"),
            ({}, "position", (0.0, 0.0, 1e30), r"1e\+30"),
            ({}, "position", (np.nan, 0.0, 1.0), "nan"),
        )
    ),
    *(
        Refusal(
            f"{name} of {value}",
            "beyond what the method means",
            lambda name=name, value=value: relit(make_scene(*SIZE), **{name: value}),
            InvalidInputError,
            f"{name}: expected",
        )
        for name, value in (
            ("gamma", -1.0),
            ("gamma", np.inf),
            ("gamma", np.nan),
            ("beta", 1.5),
            ("guidance_rescale", np.nan),
            ("steps", 0),
            ("steps", 1001),
            ("seed", -1),
            ("seed", MAX_SEED + 1),
        )
    ),
]
