"""ST-LPIPS maps against the library's own score."""

import numpy as np
import pytest
import torch

from spotlight_bench.perceptual import BATCH, PerceptualDistance


@pytest.fixture(scope="module")
def perceptual():
    return PerceptualDistance()


def noise(count, seed=0, side=48):
    return np.random.default_rng(seed).random((count, side, side, 3), dtype=np.float32)


def test_equal_pictures_are_at_no_distance(perceptual):
    truth = noise(1)[0]
    found = perceptual(truth[None], truth)
    assert found.shape == (1, 48, 48)
    np.testing.assert_array_equal(found, 0.0)


def test_the_map_averages_to_the_librarys_score(perceptual):
    """The library itself, asked for a number instead of a map, with its own scaling of inputs."""
    pictures, truth = noise(2), noise(1, seed=1)[0]
    found = perceptual(pictures, truth).mean(axis=(1, 2))
    network = perceptual._network
    network.spatial = False
    try:
        with torch.inference_mode():
            one, two = (torch.from_numpy(x).permute(0, 3, 1, 2) for x in (pictures, truth[None]))
            expected = network(one, two, normalize=True)[:, 0, 0, 0].numpy()
    finally:
        network.spatial = True
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_a_long_batch_is_as_good_as_one_by_one(perceptual):
    pictures, truth = noise(BATCH + 2, side=32), noise(1, seed=1, side=32)[0]
    together = perceptual(pictures, truth)
    assert together.shape == (BATCH + 2, 32, 32)
    alone = perceptual(pictures[-1:], truth)
    np.testing.assert_allclose(together[-1:], alone, atol=1e-5)


def test_a_blurred_picture_is_nearer_than_noise(perceptual):
    truth = np.tile(np.linspace(0, 1, 48, dtype=np.float32)[None, :, None], (48, 1, 3))
    near = np.roll(truth, 1, axis=1)
    near_distance, far_distance = perceptual(np.stack([near, noise(1)[0]]), truth).mean(axis=(1, 2))
    assert near_distance < 0.2 * far_distance
