"""What a branch is conditioned on: order, ranges, fill values, and never a NaN."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from support.scenes import make_scene, make_shadow

from runtime.scene_comparison import arrays_of
from spotlight_runtime import Intrinsics
from spotlight_runtime.diffusion.conditioning import (
    composite_maps,
    conditioning_array,
    dilate,
    masked_region,
    over,
    partial_shading,
    rough_composite,
)
from spotlight_runtime.errors import MissingMapError
from spotlight_spec import BACKBONES, MapSpec

OPENROOMS = BACKBONES["zerocomp-openrooms"]
SHADING = MapSpec("shading", 3, 1e-5, 1e3, fill=-1.0)
UNIT = st.floats(0.0, 1.0, width=32)


@pytest.fixture(scope="module")
def scene():
    return make_scene(24, 32)


@pytest.fixture(scope="module")
def shadow(scene):
    return make_shadow(scene) * (1.0 - scene.object_mask)


def planes_of(spec, array):
    """Channels by map name, each (H, W, C)."""
    planes, start = {}, 0
    for entry in spec.maps:
        planes[entry.name] = array[start : start + entry.channels].transpose(1, 2, 0)
        start += entry.channels
    assert start == len(array)
    return planes


@pytest.mark.parametrize("spec", BACKBONES.values(), ids=BACKBONES)
def test_channels_follow_the_spec(spec, scene, shadow):
    array = conditioning_array(spec, scene, shadow)
    assert array.shape == (spec.conditioning_channels, 24, 32)
    assert array.dtype == np.float32
    assert array.flags.c_contiguous
    for entry in spec.maps:
        plane = planes_of(spec, array)[entry.name]
        values = plane[plane != entry.fill] if entry.fill is not None else plane
        assert values.min() >= np.float32(entry.minimum)
        assert values.max() <= np.float32(entry.maximum)


def test_order_is_the_checkpoints_own(scene, shadow):
    """SpotLight's configuration names the mask before the shading: only the order changes."""
    depth, normal, albedo, shading, mask = OPENROOMS.maps
    other = replace(OPENROOMS, maps=(depth, normal, albedo, mask, shading))
    one = planes_of(OPENROOMS, conditioning_array(OPENROOMS, scene, shadow))
    two = planes_of(other, conditioning_array(other, scene, shadow))
    assert list(one) != list(two)
    for name, plane in one.items():
        np.testing.assert_array_equal(two[name], plane)


def test_maps_are_those_of_the_method_written_naively(scene, shadow):
    planes = planes_of(OPENROOMS, conditioning_array(OPENROOMS, scene, shadow))
    alpha = scene.object_mask.astype(np.float64)[..., None]
    back, front = scene.background_maps, scene.object_maps
    np.testing.assert_allclose(
        planes["albedo"], front.albedo + (1 - alpha) * back.albedo, atol=1e-6
    )
    normal = front.normal + (1 - alpha) * back.normal
    np.testing.assert_allclose(planes["normal"], 0.5 + 0.5 * normal, atol=1e-6)
    grown = np.pad(scene.object_mask, 1)
    around = np.max([grown[y : y + 24, x : x + 32] for y in range(3) for x in range(3)], axis=0)
    hidden = (shadow > 0.1) | (around > 0)
    assert 0.05 < hidden.mean() < 0.9
    np.testing.assert_array_equal(planes["mask"][..., 0], np.where(hidden, -1.0, 1.0))
    encoded = np.clip(scene.background.astype(np.float64), 0, 1) ** (1 / 2.2)
    shading = np.clip(encoded / (back.albedo + 1e-6), 1e-5, 1e3)
    shading[hidden] = -1.0
    np.testing.assert_allclose(planes["shading"], shading, rtol=1e-5)


def test_inverted_masks_show_what_was_hidden_and_hide_the_rest(scene, shadow):
    inverted = BACKBONES["zerocomp-inverted"]
    outside = planes_of(OPENROOMS, conditioning_array(OPENROOMS, scene, shadow))
    inside = planes_of(inverted, conditioning_array(inverted, scene, shadow))
    np.testing.assert_array_equal(inside["mask"], -outside["mask"])
    known = inside["mask"][..., 0] == 1.0
    assert (inside["shading"][known] > 0.0).all()
    assert (inside["shading"][~known] == -1.0).all()
    for name in ("depth", "normal", "albedo"):
        np.testing.assert_array_equal(inside[name], outside[name])


def test_without_shadow_only_the_object_is_hidden(scene):
    hidden = masked_region(np.zeros_like(scene.object_mask), scene.object_mask)
    np.testing.assert_array_equal(hidden, dilate(scene.object_mask) > 0)
    assert hidden.sum() > (scene.object_mask > 0).sum()


def test_shadow_threshold_is_exclusive():
    shadow = np.float32([[0.1, np.nextafter(np.float32(0.1), np.float32(1))]])
    assert masked_region(shadow, np.zeros_like(shadow)).tolist() == [[False, True]]


@pytest.mark.parametrize("side", [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_dilation_keeps_the_shape_of_slivers(side):
    mask = np.zeros(side, np.float32)
    mask[0, 0] = 0.25
    grown = dilate(mask)
    assert grown.shape == side
    assert grown.dtype == np.float32
    assert grown[:2, :2].min() == np.float32(0.25)
    assert grown.sum() == 0.25 * min(2, side[0]) * min(2, side[1])


@pytest.mark.parametrize(
    ("background", "albedo", "wanted"),
    [
        (0.0, 0.0, 1e-5),
        (1.0, 0.0, 1e3),
        (0.5, 0.5, 1.0),
        (0.0, 1.0, 1e-5),
        (1.0, 1e-3, 999.0),
        (1.0, 1e-30, 1e3),
        (1.0, -1e-6, 1e3),
        (0.0, -1e-6, 1e-5),
        (1.0, -9e-4, 1e3),
    ],
)
def test_shading_is_clamped_never_nan(background, albedo, wanted):
    """Also where interpolation left an albedo a hair below 0."""
    pixel = np.ones((1, 1, 3), np.float32)
    known = np.zeros((1, 1), bool)
    got = partial_shading(background * pixel, np.float32(albedo) * pixel, known, SHADING, 1e-6)
    np.testing.assert_allclose(got, wanted, rtol=1e-3)


def test_hidden_shading_is_the_fill_or_the_minimum():
    pixel = np.ones((1, 1, 3), np.float32)
    hidden = np.ones((1, 1), bool)
    assert (partial_shading(pixel, pixel, hidden, SHADING, 1e-6) == -1.0).all()
    unfilled = MapSpec("shading", 3, 0.25, 1e3)
    assert (partial_shading(pixel, pixel, hidden, unfilled, 1e-6) == 0.25).all()


@given(
    arrays.arrays(np.float32, (5, 6, 3), elements=st.floats(0.0, 6e4, width=32)),
    arrays.arrays(np.float32, (5, 6, 3), elements=UNIT),
    arrays.arrays(np.float32, (5, 6), elements=st.floats(0.0, 2.0**100, width=32)),
    arrays.arrays(np.float32, (5, 6), elements=UNIT),
    arrays.arrays(np.float32, (5, 6), elements=UNIT),
)
def test_any_valid_scene_conditions_in_range(background, albedo, depth, mask, shadow):
    normal = np.zeros((5, 6, 3), np.float32)
    base = make_scene(5, 6)
    scene = replace(
        base,
        background=background,
        background_maps=Intrinsics(albedo, normal, depth),
        object_maps=Intrinsics(mask[..., None] * albedo, normal, mask * depth),
        object_mask=mask,
        footprint_depth=None,
    )
    array = conditioning_array(OPENROOMS, scene, shadow)
    assert np.isfinite(array).all()
    assert array.min() >= -1.0
    assert array.max() <= 1e3


@pytest.mark.parametrize("owner", ["background", "object"])
@pytest.mark.parametrize("name", ["depth", "normal"])
def test_missing_map_is_named_with_its_owner(scene, shadow, owner, name):
    maps = replace(getattr(scene, f"{owner}_maps"), **{name: None})
    poorer = replace(scene, **{f"{owner}_maps": maps})
    with pytest.raises(MissingMapError, match=f"no {name} map of its {owner}"):
        conditioning_array(OPENROOMS, poorer, shadow)


def test_map_the_backbone_does_not_take_may_be_missing(scene, shadow):
    poorer = replace(scene, object_maps=replace(scene.object_maps, depth=None, roughness=None))
    spec = BACKBONES["zerocomp-openrooms-wo-depth"]
    assert conditioning_array(spec, poorer, shadow).shape[0] == 10
    with pytest.raises(MissingMapError, match="roughness"):
        conditioning_array(BACKBONES["zerocomp-interiorverse"], _with_depth(poorer, scene), shadow)


def _with_depth(poorer, scene):
    return replace(poorer, object_maps=replace(poorer.object_maps, depth=scene.object_maps.depth))


def test_map_no_scene_has_is_named(scene, shadow):
    spec = replace(OPENROOMS, maps=(MapSpec("irradiance", 3, 0.0, 1.0),))
    with pytest.raises(MissingMapError, match="irradiance"):
        conditioning_array(spec, scene, shadow)


def test_over_is_premultiplied():
    front, back = np.float32([[0.25]]), np.float32([[0.5]])
    assert over(front, np.float32([[0.5]]), back)[0, 0] == 0.5
    colour = over(np.zeros((1, 1, 3), "f4"), np.float32([[1.0]]), np.ones((1, 1, 3), "f4"))
    assert not colour.any()


def test_rough_composite_by_hand(scene, shadow):
    g = rough_composite(OPENROOMS, scene, shadow, 0.5)
    alpha = scene.object_mask[..., None]
    lit = 1.0 - 0.5 * shadow[..., None]
    wanted = scene.object_maps.albedo + (1 - alpha) * scene.background ** (1 / 2.2) * lit
    np.testing.assert_allclose(g, wanted, atol=1e-6)
    assert g.dtype == np.float32


def test_rough_composite_under_full_shadow_is_black(scene):
    full = 1.0 - scene.object_mask
    g = rough_composite(OPENROOMS, scene, full)
    assert not g[scene.object_mask == 0.0].any()


def test_composite_of_depth_uses_the_alignment(scene):
    """The ball is moved onto the floor it stands on: behind no floor pixel it touches."""
    depth = composite_maps(scene, ("depth",))["depth"]
    touching = (scene.footprint_depth > 0) & (scene.object_mask == 1.0)
    floor = scene.background_maps.depth
    assert np.abs(depth - floor)[touching].mean() < 0.2
    outside = scene.object_mask == 0.0
    np.testing.assert_array_equal(depth[outside], floor[outside])


def test_inputs_are_left_alone(scene, shadow):
    before = {name: array.copy() for name, array in arrays_of(scene).items()}
    for array in arrays_of(scene).values():
        array.setflags(write=False)
    conditioning_array(OPENROOMS, scene, shadow)
    rough_composite(OPENROOMS, scene, shadow)
    for name, array in arrays_of(scene).items():
        np.testing.assert_array_equal(array, before[name])
