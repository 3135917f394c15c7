"""A network's maps, brought back to the photograph's pixels."""

import numpy as np
import pytest
from support.rooms import oracle_network, room

from spotlight_runtime.composing.estimator import (
    MULTIPLE,
    WORKING_SIDE,
    estimate_intrinsics,
    estimate_small,
)
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.errors import NumericalError


def test_network_is_asked_for_what_its_contract_says():
    asked = {}

    def network(image):
        asked["image"] = image
        return {"maps": np.full((1, 7, *image.shape[2:]), 0.5, np.float32)}

    for size in ((1000, 1500), (700, 300), (100, 200), (40, 33)):
        radiance = np.full((*size, 3), 2.0, np.float32)
        small = estimate_small(network, Photograph(radiance))
        image = asked["image"]
        assert image.dtype == np.float32
        assert image.shape[:2] == (1, 3)
        assert all(side % MULTIPLE == 0 and 0 < side <= WORKING_SIDE for side in image.shape[2:])
        assert image.max() == pytest.approx(1.0)  # as white as can be
        assert small.albedo.shape == (*image.shape[2:], 3)


def test_maps_have_the_photographs_size_and_ranges(rng):
    photograph = Photograph(rng.random((211, 333, 3), dtype=np.float32))

    def network(image):
        maps = rng.normal(size=(1, 7, *image.shape[2:])).astype(np.float32)
        return {"maps": maps}

    maps = estimate_intrinsics(network, photograph)
    maps.check((211, 333), "background")
    np.testing.assert_allclose(np.linalg.norm(maps.normal, axis=2), 1.0, atol=1e-3)
    assert maps.depth.min() > 0.0


def test_uniform_maps_stay_uniform(rng):
    """Whatever the picture's texture, it does not print through into normals and depth."""
    photograph = Photograph(rng.random((500, 400, 3), dtype=np.float32))
    planes = np.float32([0.5, 0.5, 0.5, 0.0, 0.6, 0.8, 3.0])

    def network(image):
        return {"maps": np.broadcast_to(planes[None, :, None, None], (1, 7, *image.shape[2:]))}

    maps = estimate_intrinsics(network, photograph)
    np.testing.assert_allclose(maps.depth, 3.0, rtol=1e-3)
    np.testing.assert_allclose(
        maps.normal, np.broadcast_to([0.0, 0.6, 0.8], maps.normal.shape), atol=1e-3
    )


def test_albedo_keeps_the_photographs_texture():
    """Where light is even, fine texture is albedo, though the network cannot have seen it."""
    rows, columns = np.mgrid[:768, :768]
    texture = np.where((rows + columns) % 2 == 0, 0.2, 0.6)[..., None]
    albedo = (texture * np.array([1.0, 0.8, 0.5])).astype(np.float32)
    photograph = Photograph(np.float32(0.7) * albedo)
    mean = albedo.mean(axis=(0, 1))

    def network(image):
        flat = np.concatenate([mean, [0.0, 0.0, 1.0, 2.0]]).astype(np.float32)
        return {"maps": np.broadcast_to(flat[None, :, None, None], (1, 7, *image.shape[2:]))}

    found = estimate_intrinsics(network, photograph).albedo
    np.testing.assert_allclose(found, albedo, rtol=0.05)


def test_depth_follows_the_pictures_edges():
    backdrop = room(960, 720, block=(-1.0, 0.2, 2.5))
    maps = estimate_intrinsics(oracle_network(backdrop), backdrop.photograph)
    truth = backdrop.maps
    error = np.abs(maps.depth - truth.depth) / truth.depth
    assert np.median(error) < 0.005
    assert (error > 0.1).mean() < 0.03
    angle = np.degrees(np.arccos(np.clip((maps.normal * truth.normal).sum(axis=2), -1, 1)))
    assert np.median(angle) < 2.0
    assert np.median(np.abs(maps.albedo - truth.albedo)) < 0.03


def test_black_picture_has_maps():
    def network(image):
        return {"maps": np.full((1, 7, *image.shape[2:]), 0.5, np.float32)}

    maps = estimate_intrinsics(network, Photograph(np.zeros((64, 64, 3), np.float32)))
    maps.check((64, 64), "background")


def test_network_that_fails_is_named():
    def network(image):
        return {"maps": np.full((1, 7, *image.shape[2:]), np.nan, np.float32)}

    with pytest.raises(
        NumericalError, match=r"attic: estimating the maps: 28672 of 28672 .*--albedo"
    ):
        estimate_intrinsics(network, Photograph(np.ones((64, 64, 3), np.float32), name="attic"))
