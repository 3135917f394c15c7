"""Sketches without diffusion."""

from dataclasses import replace

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow
from support.shadow_scenes import ball_scene

from spotlight_runtime import GuidingShadow, Light
from spotlight_runtime.errors import InvalidInputError, ShapeError
from spotlight_runtime.imaging.colour import linear_to_srgb, srgb_to_linear
from spotlight_runtime.relighting.preview import OPACITY, preview, preview_each


@pytest.fixture(scope="module")
def scene():
    return make_scene(64, 96)


@pytest.fixture(scope="module")
def shadow(scene):
    return make_shadow(scene) * (1 - scene.object_mask)


def test_background_is_darkened_by_the_shadow_and_else_kept(scene, shadow):
    made = preview(scene, shadow)
    assert made.guides[0].positive is shadow
    kept = linear_to_srgb(scene.background)
    untouched = (shadow == 0) & (scene.object_mask == 0)
    np.testing.assert_array_equal(made.image[untouched], kept[untouched])
    shaded = (shadow > 0) & (scene.object_mask == 0)
    wanted = scene.background * (1 - OPACITY * shadow)[..., None]
    np.testing.assert_allclose(srgb_to_linear(made.image)[shaded], wanted[shaded], atol=1e-5)


def test_object_is_its_albedo_under_a_light_from_above(scene, shadow):
    made = srgb_to_linear(preview(scene, shadow).image)
    inside = scene.object_mask == 1
    brightness = made[inside] / scene.object_maps.albedo[inside]
    np.testing.assert_allclose(brightness.std(axis=1), 0.0, atol=1e-4)
    rows, columns = np.nonzero(inside)
    middle = np.abs(columns - 48) < 3
    upper, lower = middle & (rows < 28), middle & (rows > 40)
    assert brightness[upper].mean() > 1.2 * brightness[lower].mean()


def test_lit_side_faces_the_light():
    pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")
    scene = ball_scene(96)
    rows, columns = np.nonzero(scene.object_mask)
    centre = columns.mean()
    across = (np.arange(96) - centre) / (np.ptp(columns) / 2)
    normal = np.zeros((96, 96, 3), np.float32)
    normal[..., 0] = np.clip(across, -1, 1)
    normal[..., 2] = np.sqrt(1 - normal[..., 0] ** 2)
    maps = replace(scene.object_maps, normal=normal * scene.object_mask[..., None])
    scene = replace(scene, object_maps=maps)
    right = columns > centre
    for light, brighter in (
        (Light(azimuth=0.0, elevation=30.0), right),
        (Light(azimuth=180.0, elevation=30.0), ~right),
        (Light(azimuth=0.0, elevation=30.0, frame="camera"), right),
        (Light(position=(-5.0, 0.0, 4.0)), ~right),
        (Light(position=(5.0, 4.0, 0.0), frame="camera"), right),
    ):
        values = preview(scene, light).image[rows, columns, 0]
        assert values[brighter].mean() > 1.1 * values[~brighter].mean(), light


def test_a_light_in_the_cameras_frame_is_seen_from_where_the_object_is():
    """Also where no mesh says where that is."""
    from spotlight_runtime.relighting.preview import _towards

    scene = make_scene(64, 96)
    light = Light(position=(0.0, 3.0, -2.9), frame="camera")
    assert _towards(scene, light) @ np.float32([0.0, 1.0, 0.0]) > 0.95
    flat = replace(scene, object_maps=replace(scene.object_maps, depth=None))
    assert np.linalg.norm(_towards(flat, light)) == pytest.approx(1.0)
    floor = Light(azimuth=90.0, elevation=60.0)
    assert _towards(scene, floor)[1] > 0.5


def test_several_lights_in_one_sketch_or_in_one_each(scene, shadow):
    other = make_shadow(scene, "right") * (1 - scene.object_mask)
    lights = [GuidingShadow(shadow, weight=3.0), GuidingShadow(other)]
    together = preview(scene, lights)
    alone = list(preview_each(scene, lights))
    assert len(alone) == len(together.guides) == 2
    wanted = 0.75 * srgb_to_linear(alone[0].image) + 0.25 * srgb_to_linear(alone[1].image)
    np.testing.assert_allclose(srgb_to_linear(together.image), wanted, atol=1e-5)


@pytest.mark.parametrize("size", [(1, 1), (7, 5), (30, 400)])
def test_any_size_and_any_maps(size):
    scene = make_scene(*size)
    bare = replace(scene, object_maps=replace(scene.object_maps, normal=None, depth=None))
    for each in (scene, bare):
        made = preview(each, make_shadow(each)).image
        assert made.shape == (*size, 3)
        assert np.isfinite(made).all()


def test_black_photograph_and_black_albedo(scene, shadow):
    black = np.zeros_like(scene.background)
    maps = replace(scene.background_maps, albedo=black)
    assert np.isfinite(
        preview(replace(scene, background=black, background_maps=maps), shadow).image
    ).all()


def test_bad_lights_are_named(scene, shadow):
    with pytest.raises(ShapeError, match="shadow: expected shape"):
        preview(scene, shadow[:-1])
    with pytest.raises(InvalidInputError, match="at least one"):
        preview(scene, [])
