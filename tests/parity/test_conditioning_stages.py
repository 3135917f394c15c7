"""From maps to conditioning, each stage against the oracle's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from oracle import conditioning as method
from oracle.masks import square_dilation
from support.scenes import make_scene

from spotlight_runtime import Intrinsics, Scene
from spotlight_runtime.diffusion import conditioning
from spotlight_runtime.relighting.preparation import prepare
from spotlight_spec import BACKBONES

from .awkward import IMAGE_SIZES, MASKS, mask_named
from .bridge import array, conditioning_of, tensor

SINGLE = {"rtol": 2e-6, "atol": 1e-6}
SIZE = (40, 24)
CONTROLNETS = [name for name, spec in BACKBONES.items() if spec.conditioning_layout == "controlnet"]


def uniform(seed: int, *shape: int, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, shape).astype(np.float32)


@pytest.mark.parametrize("alpha", MASKS)
@pytest.mark.parametrize("channels", [(), (3,)])
def test_over(alpha: str, channels: tuple[int, ...]) -> None:
    cover, behind = mask_named(alpha, SIZE), uniform(1, *SIZE, *channels)
    in_front = uniform(2, *SIZE, *channels) * (cover[..., None] if channels else cover)
    expected = method.over(tensor(in_front), tensor(behind), tensor(cover))
    np.testing.assert_allclose(
        conditioning.over(in_front, cover, behind), array(expected), **SINGLE
    )


@pytest.mark.parametrize("size", IMAGE_SIZES)
@pytest.mark.parametrize("shadow", MASKS)
@pytest.mark.parametrize("covered", ["empty", "full", "sparse", "pixel"])
def test_masked_region(shadow: str, covered: str, size: tuple[int, int]) -> None:
    m_shw, m_obj = mask_named(shadow, size), mask_named(covered, size, seed=1)
    expected = method.masked_region(tensor(m_shw), tensor(m_obj))[0]
    np.testing.assert_array_equal(conditioning.masked_region(m_shw, m_obj), expected)


@pytest.mark.parametrize("mask", MASKS)
def test_dilation(mask: str) -> None:
    m_obj = mask_named(mask, SIZE)
    np.testing.assert_array_equal(conditioning.dilate(m_obj), square_dilation(tensor(m_obj))[0])


@pytest.mark.parametrize("hidden", ["empty", "full", "corner", "sparse"])
def test_shading_quotient(hidden: str) -> None:
    """Also where photograph or albedo is black, and where the quotient leaves its range."""
    spec = BACKBONES["zerocomp-openrooms"]
    entry = next(entry for entry in spec.maps if entry.name == "shading")
    background, albedo = uniform(3, *SIZE, 3), uniform(4, *SIZE, 3)
    background[:8] = 0.0
    albedo[4:12] = 0.0
    albedo[12:16] = 1e-7
    region = mask_named(hidden, SIZE) > 0.0
    expected = method.masked_shading(
        tensor(background), tensor(albedo), torch.from_numpy(region)[None]
    )
    actual = conditioning.partial_shading(background, albedo, region, entry, spec.shading.epsilon)
    np.testing.assert_allclose(actual, array(expected), **SINGLE)


@pytest.mark.parametrize("covered", ["corner", "line", "sparse"])
def test_depth_aligned_to_the_footprint(covered: str) -> None:
    alpha, footprint = mask_named(covered, SIZE), mask_named("sparse", SIZE, seed=5)
    behind = uniform(6, *SIZE, low=2.0, high=9.0)
    foot = footprint * (0.4 * behind + 0.2 + uniform(7, *SIZE, low=-0.3, high=0.3))
    depth = alpha * uniform(8, *SIZE, low=1.0, high=4.0)
    m, c = conditioning.align_depth(depth, alpha, behind, foot)
    expected = method.aligned_to_footprint(
        tensor(depth), tensor(alpha), tensor(foot), tensor(foot) > 0.0, tensor(behind)
    )
    np.testing.assert_allclose(m * depth + c * alpha, array(expected), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("covered", ["corner", "pixel", "soft", "full"])
def test_depth_aligned_to_the_nearest(covered: str) -> None:
    alpha = mask_named(covered, SIZE)
    behind = uniform(6, *SIZE, low=2.0, high=9.0)
    depth = alpha * uniform(8, *SIZE, low=1.0, high=4.0)
    m, c = conditioning.align_depth(depth, alpha, behind)
    expected = method.aligned_to_nearest(
        tensor(depth), tensor(alpha), tensor(alpha) > 0.5, tensor(behind)
    )
    np.testing.assert_allclose(m * depth + c * alpha, array(expected), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("backbone", CONTROLNETS)
@pytest.mark.parametrize("shadow", ["empty", "full", "soft", "corner"])
def test_conditioning(scene: Scene, backbone: str, shadow: str) -> None:
    spec = BACKBONES[backbone]
    drawn = mask_named(shadow, scene.size)
    _, (ours, _) = prepare(spec, scene, drawn, None)
    m_shw = method.guiding_shadow(tensor(drawn), tensor(scene.object_mask))
    np.testing.assert_allclose(ours, m_shw[0], **SINGLE)
    actual = conditioning.conditioning_array(spec, scene, ours)
    expected = conditioning_of(spec, scene, m_shw)
    np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("covered", ["empty", "full"])
def test_conditioning_without_background_or_object(scene: Scene, covered: str) -> None:
    spec = BACKBONES["zerocomp-interiorverse"]
    alpha = mask_named(covered, scene.size)
    bare = {
        name: getattr(make_scene().background_maps, name)
        * (alpha if name in ("depth", "roughness", "metallic") else alpha[..., None])
        for name in ("albedo", "normal", "depth", "roughness", "metallic")
    }
    changed = replace(scene, object_mask=alpha, object_maps=Intrinsics(**bare))
    m_shw = method.guiding_shadow(tensor(mask_named("soft", scene.size)), tensor(alpha))
    actual = conditioning.conditioning_array(spec, changed, m_shw[0].numpy().astype(np.float32))
    expected = conditioning_of(spec, changed, m_shw)
    np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-6)
