"""The stages on the latent grid, each against its equation: masks, guidance, blending."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from oracle import masks as method
from oracle.guidance import masked_guidance, rescaled_guidance
from oracle.loop import blended
from oracle.schedule import noised

from spotlight_runtime.diffusion import blending, guidance

from .awkward import IMAGE_SIZES, MASKS, mask_named
from .bridge import tensor

SINGLE = {"rtol": 2e-6, "atol": 2e-6}
DOUBLE = {"rtol": 1e-12, "atol": 1e-12}
PRECISIONS = [(np.float32, SINGLE), (np.float64, DOUBLE)]
LATENTS = (2, 4, 5, 7)


def normal(seed: int, dtype: type, shape: tuple[int, ...] = LATENTS) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape).astype(dtype)


def exact(values: np.ndarray) -> torch.Tensor:
    """The same numbers in float64."""
    return torch.from_numpy(values.astype(np.float64))


@pytest.mark.parametrize("size", IMAGE_SIZES)
@pytest.mark.parametrize("shadow", MASKS)
@pytest.mark.parametrize("covered", ["empty", "soft", "corner", "full"])
def test_latent_shadow_mask(shadow: str, covered: str, size: tuple[int, int]) -> None:
    m_shw, m_obj = mask_named(shadow, size), mask_named(covered, size, seed=1)
    expected = method.latent_shadow_mask(tensor(m_shw), tensor(m_obj), (size[0] // 8, size[1] // 8))
    actual = blending.latent_shadow_mask(m_shw, m_obj, 8)
    np.testing.assert_array_equal(actual, expected[0])


@pytest.mark.parametrize("downscale", [1, 2, 3, 4, 8])
@pytest.mark.parametrize("mask", MASKS)
@pytest.mark.parametrize("antialias", [False, True])
def test_downsampling(mask: str, downscale: int, antialias: bool) -> None:
    size = (5 * downscale, 7 * downscale)
    image = mask_named(mask, size)
    ours = blending.downsample_antialiased if antialias else blending.downsample_bilinear
    expected = method.bilinear(tensor(image), (5, 7), antialias=antialias)[0]
    np.testing.assert_allclose(ours(image, downscale), expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISIONS)
@pytest.mark.parametrize("gamma", [0.0, 0.5, 1.0, 3.0, 7.0])
@pytest.mark.parametrize("mask", ["empty", "full", "soft"])
def test_masked_guidance(mask: str, gamma: float, dtype: type, tolerance: dict) -> None:
    v_pos, v_neg = normal(0, dtype)[:1], normal(1, dtype)[:1]
    m = mask_named(mask, LATENTS[2:]).astype(dtype)[None, None]
    expected = masked_guidance(exact(v_pos), exact(v_neg), exact(m), gamma)
    actual = guidance.masked_guidance(v_pos, v_neg, m, gamma)
    assert actual.dtype == dtype
    np.testing.assert_allclose(actual, expected, rtol=0, atol=10 * tolerance["atol"])


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISIONS)
@pytest.mark.parametrize("phi", [0.3, 0.7, 1.0])
@pytest.mark.parametrize("mask", ["full", "corner", "soft"])
def test_guidance_rescale_on_the_object(
    mask: str, phi: float, dtype: type, tolerance: dict
) -> None:
    """Deviations of the object, applied to the whole prediction."""
    v, v_pos = 3.0 * normal(2, dtype)[:1] + dtype(0.5), normal(3, dtype)[:1]
    m = mask_named(mask, LATENTS[2:]).astype(dtype)[None, None]
    expected = rescaled_guidance(exact(v), exact(v_pos), exact(m), phi)
    actual = guidance.rescale_guidance(v, v_pos, m, phi)
    np.testing.assert_allclose(actual, expected, **tolerance)


def test_guidance_rescale_without_an_object() -> None:
    v, v_pos, m = normal(2, np.float32)[:1], normal(3, np.float32)[:1], np.zeros((1, 1, 5, 7))
    expected = rescaled_guidance(exact(v), exact(v_pos), exact(m), 0.7)
    np.testing.assert_array_equal(guidance.rescale_guidance(v, v_pos, m, 0.7), expected)


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISIONS)
@pytest.mark.parametrize("alpha_bar", [0.0, 2.0**-24, 0.3, 0.99915, 1.0])
def test_noise(alpha_bar: float, dtype: type, tolerance: dict) -> None:
    clean, epsilon = normal(4, dtype), normal(5, dtype)
    level = torch.tensor(alpha_bar, dtype=torch.float64)
    expected = noised(exact(clean), exact(epsilon), level)
    actual = blending.add_noise(clean, epsilon, alpha_bar)
    assert actual.dtype == dtype
    np.testing.assert_allclose(actual, expected, **tolerance)


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISIONS)
@pytest.mark.parametrize("beta", [0.0, 0.05, 0.2, 0.5])
def test_blending(beta: float, dtype: type, tolerance: dict) -> None:
    """Up to β = 0.5, where an edge's weight of 2 has taken over the latents."""
    z, composite = normal(6, dtype), normal(7, dtype)
    mask = np.random.default_rng(8).integers(0, 3, (2, 1, 5, 7)).astype(dtype)
    expected = blended(exact(z), exact(composite), exact(mask), beta)
    actual = blending.blend_shadow(z, composite, mask, beta)
    assert actual.dtype == dtype
    np.testing.assert_allclose(actual, expected, **tolerance)
