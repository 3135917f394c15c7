"""Light following on balls whose light is known."""

from dataclasses import replace

import numpy as np
import pytest
from support.scenes import make_scene

from bench.published import lit
from spotlight_bench import following
from spotlight_runtime.imaging.colour import linear_to_srgb


@pytest.fixture(scope="module")
def scene():
    """A ball of a checked albedo, which must not be taken for shading."""
    scene = make_scene(64, 64)
    rows, columns = np.mgrid[:64, :64]
    checks = np.where((rows // 4 + columns // 4) % 2, 1.0, 0.35)[..., None].astype(np.float32)
    maps = replace(scene.object_maps, albedo=scene.object_maps.albedo * checks)
    return replace(scene, object_maps=maps)


@pytest.fixture(scope="module")
def truths(scene):
    return [following.shading(linear_to_srgb(lit(scene, k)), scene) for k in range(8)]


def found(scene, truths, picture, **options):
    return following.distances(following.shading(picture, scene), truths, **options)


@pytest.mark.parametrize("offset_free", [False, True])
@pytest.mark.parametrize("strength", [0.3, 1.0, 1.2])
def test_the_light_is_found_whatever_its_strength(scene, truths, strength, offset_free):
    for k in range(8):
        picture = linear_to_srgb(np.float32(strength) * lit(scene, k))
        distances = found(scene, truths, picture, offset_free=offset_free)
        assert following.is_right(distances, k)
        assert min(distances) == pytest.approx(0.0, abs=1e-3)


def test_a_light_between_two_is_near_both_and_right_for_one(scene, truths):
    mixed = 0.7 * lit(scene, 7) + 0.3 * lit(scene, 0)
    distances = found(scene, truths, linear_to_srgb(mixed))
    assert following.is_right(distances, 7)
    assert not following.is_right(distances, 0)
    assert following.is_near(distances, 0)
    assert following.is_near(distances, 6)
    assert not following.is_near(distances, 1)


def test_flat_contrast_is_followed_when_the_constant_is_free(scene, truths):
    """The same shape of shading under four times the ambient light."""
    for k in range(8):
        picture = linear_to_srgb(lit(scene, k, ambient=0.8, strength=0.2))
        assert following.is_right(found(scene, truths, picture, offset_free=True), k)


def test_one_picture_for_all_lights_is_right_once_in_eight(scene, truths):
    distances = found(scene, truths, linear_to_srgb(lit(scene, 3)))
    assert sum(following.is_right(distances, k) for k in range(8)) == 1
    assert sum(following.is_near(distances, k) for k in range(8)) == 3


def test_black_and_flat_shadings_resemble_no_light(scene, truths):
    black = found(scene, truths, np.zeros((64, 64, 3), np.float32))
    assert black == [1.0] * 8
    pasted = linear_to_srgb(scene.object_maps.albedo)
    flat = found(scene, truths, pasted, offset_free=True)
    assert min(flat) > 0.3


def test_what_is_around_the_object_does_not_count(scene, truths):
    picture = linear_to_srgb(lit(scene, 5))
    other = np.where(scene.object_mask[..., None] >= 0.5, picture, 0.0).astype(np.float32)
    assert found(scene, truths, picture) == found(scene, truths, other)
    soft = linear_to_srgb(lit(replace(scene, background=4.0 * scene.background), 5))
    assert found(scene, truths, picture) == found(scene, truths, soft)


def test_shading_is_the_light_without_the_albedo(scene):
    shading = following.shading(linear_to_srgb(0.5 * scene.object_maps.albedo), scene)
    assert shading.size == (scene.object_mask >= 0.99).sum()
    np.testing.assert_allclose(shading, 0.5, atol=2e-3)


def test_the_thinnest_object_still_has_a_shading(scene):
    thin = replace(
        scene,
        object_mask=np.float32(0.6) * scene.object_mask,
        object_maps=replace(scene.object_maps, albedo=0.6 * scene.object_maps.albedo),
    )
    found = following.shading(linear_to_srgb(scene.object_maps.albedo), thin)
    assert found.size > 100
