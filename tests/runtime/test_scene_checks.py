"""A scene is checked once, when it is made; what is wrong is named."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from support.scenes import make_scene

from runtime.scene_comparison import arrays_of, assert_same_scene
from spotlight_runtime import Intrinsics, Scene
from spotlight_runtime.errors import (
    DtypeError,
    InvalidInputError,
    NonFiniteError,
    ShapeError,
    SpotLightError,
)

PLAIN = ["object_mask", "footprint_depth", "truth"]
MAPS = [
    f"{owner} {name}"
    for owner in ("background", "object")
    for name in ("albedo", "normal", "depth", "roughness", "metallic")
]
EVERY = ["background", *PLAIN, *MAPS]


def with_array(scene, name, array):
    """The scene with one of its arrays replaced."""
    if name in ("background", *PLAIN):
        return replace(scene, **{name: array})
    owner, field = name.split()
    maps = replace(getattr(scene, f"{owner}_maps"), **{field: array})
    return replace(scene, **{f"{owner}_maps": maps})


@pytest.fixture(scope="module")
def small():
    return make_scene(12, 16)


def test_the_tests_know_every_array(small):
    assert set(arrays_of(small)) == set(EVERY)


@pytest.mark.parametrize("name", EVERY)
def test_wrong_dtype_is_named(small, name):
    array = arrays_of(small)[name]
    for dtype in (np.float64, np.float16, np.uint8):
        with pytest.raises(DtypeError, match=f"{name}: expected a float32.* {dtype.__name__}"):
            with_array(small, name, array.astype(dtype))


@pytest.mark.parametrize("name", [n for n in EVERY if n != "background"])
def test_wrong_size_is_named(small, name):
    array = arrays_of(small)[name]
    for wrong in (
        array[:-1],
        array[:, 1:],
        array.swapaxes(0, 1),
        array[None],
        array[..., 0],
        array[:0],
    ):
        with pytest.raises(ShapeError, match=f"{name}: expected shape"):
            with_array(small, name, wrong)


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_named(small, name, bad):
    array = arrays_of(small)[name].copy()
    array[3, 5] = bad
    with pytest.raises(NonFiniteError, match=f"{name}: [13] of"):
        with_array(small, name, array)


@pytest.mark.parametrize("name", EVERY)
def test_values_out_of_range_are_named(small, name):
    array = arrays_of(small)[name].copy()
    array[0, 0] = -1.5
    with pytest.raises(InvalidInputError, match=rf"{name}: expected values in \["):
        with_array(small, name, array)
    if "depth" not in name and name not in ("background", "truth"):
        array[0, 0] = 255.0
        with pytest.raises(InvalidInputError, match=rf"{name}: expected values in \["):
            with_array(small, name, array)


@pytest.mark.parametrize("name", ["background albedo", "object normal", "truth"])
@pytest.mark.parametrize("channels", [1, 2, 4])
def test_colour_maps_have_three_channels(small, name, channels):
    with pytest.raises(ShapeError, match=name):
        with_array(small, name, np.zeros((12, 16, channels), np.float32))


@pytest.mark.parametrize(
    "background",
    [
        None,
        "room.jpg",
        np.zeros((4, 4), np.float32),
        np.zeros((4, 4, 4), np.float32),
        np.float32(1),
    ],
)
def test_background_is_a_colour_picture(small, background):
    with pytest.raises(ShapeError, match=r"background: expected .*shape \(.*3\)"):
        replace(small, background=background)


@pytest.mark.parametrize("shape", [(0, 0, 3), (0, 16, 3), (12, 0, 3)])
def test_a_scene_has_pixels(shape):
    empty = np.zeros(shape, np.float32)
    with pytest.raises(ShapeError, match="empty"):
        Scene(empty, Intrinsics(empty), Intrinsics(empty), empty[..., 0])


@pytest.mark.parametrize("angle", [0.0, -10.0, 180.0, 360.0, np.nan, np.inf])
def test_field_of_view_is_an_angle(small, angle):
    with pytest.raises(InvalidInputError, match="field_of_view: expected degrees"):
        replace(small, field_of_view=angle)


def test_only_albedo_and_mask_are_required(small):
    scene = Scene(
        small.background,
        Intrinsics(small.background_maps.albedo),
        Intrinsics(small.object_maps.albedo),
        small.object_mask,
    )
    assert scene.has_map("albedo")
    assert not scene.has_map("depth")
    assert not replace(scene, background_maps=small.background_maps).has_map("depth")
    assert small.has_map("depth")
    assert scene.padded(8).size == (16, 16)


@given(
    arrays.arrays(
        dtype=st.sampled_from([np.float32, np.float64, np.uint8, np.float16, np.int32]),
        shape=arrays.array_shapes(min_dims=1, max_dims=4, min_side=1, max_side=4),
    ),
    st.sampled_from(EVERY),
)
def test_any_array_anywhere_is_a_scene_or_one_error_of_the_tree(array, name):
    small = make_scene(3, 4)
    try:
        scene = with_array(small, name, array)
    except SpotLightError as error:
        assert str(error).split(":")[0] in EVERY  # noqa: PT017
    else:
        assert np.isfinite(arrays_of(scene)[name]).all()
        assert arrays_of(scene)[name].dtype == np.float32


@pytest.mark.parametrize("size", [(1, 1), (7, 5), (8, 8), (9, 16), (17, 23)])
def test_padded_scene_holds_the_scene(size):
    scene = make_scene(*size)
    padded = scene.padded(8)
    height, width = size
    assert padded.size == (-(-height // 8) * 8, -(-width // 8) * 8)
    cropped = {name: array[:height, :width] for name, array in arrays_of(padded).items()}
    for name, array in arrays_of(scene).items():
        np.testing.assert_array_equal(cropped[name], array)
    assert (padded.name, padded.field_of_view) == (scene.name, scene.field_of_view)


def test_scene_that_fits_is_not_copied():
    scene = make_scene(16, 24)
    assert scene.padded(8) is scene
    assert_same_scene(scene.padded(1), scene)


def test_scenes_cannot_be_changed_under_a_relight(small):
    with pytest.raises(AttributeError):
        small.name = "other"


@pytest.mark.parametrize("name", ["albedo", "normal", "depth", "roughness"])
def test_object_maps_that_go_on_beside_the_object_are_refused(small, name):
    """They would be added to the photograph's own."""
    whole = {name: getattr(small.background_maps, name)}
    with pytest.raises(InvalidInputError, match=f"object {name}: expected 0 .*multiply the map by"):
        replace(small, object_maps=replace(small.object_maps, **whole))


def test_object_maps_may_go_beyond_the_mask_a_little(small):
    """A harder mask leaves some of the edge beside it, and 8-bit normals have no zero."""
    harder = np.where(small.object_mask > 0.5, small.object_mask, np.float32(0.0))
    normal = np.where(small.object_mask[..., None] > 0.0, small.object_maps.normal, 1 / 255)
    maps = replace(small.object_maps, normal=normal.astype(np.float32))
    assert ((harder == 0.0) & (small.object_maps.albedo.max(axis=2) > 0.1)).any()
    replace(small, object_mask=harder, object_maps=maps)
