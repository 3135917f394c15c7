"""From latents to the picture: the codec, and background preservation in both its forms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from oracle import composite as method
from oracle.conditioning import for_encoder
from oracle.networks import Backbone

from spotlight_runtime.imaging import colour
from spotlight_runtime.networks import codec
from spotlight_runtime.relighting import composite
from spotlight_spec import BackboneSpec

from .awkward import MASKS, mask_named
from .bridge import array, tensor
from .measure import Tolerance, assert_within
from .networks import as_networks

SINGLE = {"rtol": 5e-6, "atol": 2e-6}
SIZE = (40, 24)
PARTIAL = [name for name in MASKS if name != "full"]


def pictures() -> list[np.ndarray]:
    """Background, prediction and no-shadow prediction; black in places."""
    rng = np.random.default_rng(0)
    background, predicted, no_shadow = rng.uniform(size=(3, *SIZE, 3)).astype(np.float32)
    predicted[:6] = 0.0
    no_shadow[3:9] = 0.0
    predicted[20:] = no_shadow[20:] * np.float32(0.5)
    return [background, predicted, no_shadow]


def test_intensity_and_ratio() -> None:
    _, predicted, no_shadow = pictures()
    expected = method.intensity(tensor(predicted))
    np.testing.assert_allclose(colour.luma(predicted), expected[0], **SINGLE)
    ratio = method.shadow_ratio(tensor(predicted), tensor(no_shadow))
    np.testing.assert_allclose(composite.shadow_ratio(predicted, no_shadow), ratio[0], **SINGLE)


@pytest.mark.parametrize("region", MASKS)
def test_ratio_limited_to_the_region(region: str) -> None:
    hidden = mask_named(region, SIZE)
    ratio = np.random.default_rng(1).uniform(size=SIZE).astype(np.float32)
    expected = method.region_ratio(tensor(ratio), tensor(hidden > 0.0))
    actual = composite.limit_to_region(ratio, hidden > 0.0)
    np.testing.assert_allclose(actual, expected[0], **SINGLE)


@pytest.mark.parametrize("covered", PARTIAL)
def test_colour_balance(covered: str) -> None:
    background, _, no_shadow = pictures()
    mask = mask_named(covered, SIZE)
    expected = method.colour_balance(tensor(background), tensor(no_shadow), tensor(mask))
    actual = composite.colour_balance(background, no_shadow, mask)
    np.testing.assert_allclose(actual, expected.flatten(), **SINGLE)


@pytest.mark.parametrize("covered", ["empty", "line", "corner", "pixel"])
@pytest.mark.parametrize("region", [None, "empty", "soft", "corner", "full"])
def test_composite(covered: str, region: str | None) -> None:
    background, predicted, no_shadow = pictures()
    m_obj = mask_named(covered, SIZE)
    hidden = None if region is None else mask_named(region, SIZE, seed=2) > 0.5
    expected = method.composited(
        tensor(predicted),
        tensor(no_shadow),
        tensor(background),
        tensor(m_obj),
        None if hidden is None else tensor(hidden),
    ).clamp(0.0, 1.0)
    actual, untouched = composite.compose_picture(background, predicted, no_shadow, m_obj, hidden)
    np.testing.assert_allclose(actual, array(expected), **SINGLE)
    np.testing.assert_array_equal(actual[untouched], background[untouched])


@pytest.fixture(scope="module")
def networks(backbone32: Backbone) -> dict[str, Callable[..., dict[str, np.ndarray]]]:
    return as_networks(backbone32)


@pytest.mark.parametrize("size", [(16, 24), (40, 24)])
@pytest.mark.parametrize("sampled", [False, True])
def test_encoding(
    networks: dict, backbone64: Backbone, spec: BackboneSpec, size: tuple[int, int], sampled: bool
) -> None:
    """E(g)·s of encoded pixels."""
    rng = np.random.default_rng(4)
    encoded = rng.uniform(0.0, 1.0, (*size, 3)).astype(np.float32)
    epsilon = rng.standard_normal((1, 4, size[0] // 8, size[1] // 8)).astype(np.float32)
    mean, deviation = backbone64.posterior(for_encoder(tensor(encoded)))
    z = mean + deviation * torch.from_numpy(epsilon[0]).double() if sampled else mean
    actual = codec.encode_image(networks, spec, encoded, epsilon if sampled else None)
    assert_within(Tolerance(1e-5, 1e-5), actual[0], z * backbone64.scale)


def test_decoding(networks: dict, backbone64: Backbone, spec: BackboneSpec) -> None:
    z = np.random.default_rng(5).standard_normal((1, 4, 5, 3)).astype(np.float32)
    image = backbone64.decoded(torch.from_numpy(z[0]).double())
    expected = array((0.5 * image + 0.5).clamp(0.0, 1.0))
    actual = codec.decode_latents(networks, spec, z)
    assert_within(Tolerance(1e-5, 1e-5), actual, expected)
