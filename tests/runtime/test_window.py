"""What part of a photograph is diffused, and how it looks at the model's scale."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scenes import make_scene, make_shadow

from spotlight_runtime.relighting.window import (
    COARSE,
    LARGEST_OBJECT,
    MARGIN,
    Window,
    choose_window,
    look,
    shrink,
)

SIZE, MULTIPLE = 64, 8


def blank(height, width):
    return np.zeros((height, width), np.float32)


def with_box(height, width, top, left, bottom, right, value=1.0):
    mask = blank(height, width)
    mask[top:bottom, left:right] = value
    return mask


def chosen(mask, *shadows, mode="auto"):
    return choose_window(SIZE, MULTIPLE, mask, shadows, mode)


@pytest.mark.parametrize("frame", [(64, 64), (32, 128), (1, 4096), (61, 43), (1, 1)])
def test_a_photograph_of_the_models_pixels_is_diffused_whole(frame):
    window = chosen(with_box(*frame, 0, 0, 1, 1))
    assert window == Window.whole(frame)
    assert window.native
    assert window.scale == 1.0


def test_frame_is_the_whole_photograph_whatever_its_size():
    assert chosen(with_box(900, 1200, 5, 5, 9, 9), mode="frame") == Window.whole((900, 1200))


def test_small_things_in_a_large_photograph_are_seen_at_its_own_scale():
    """Nothing is enlarged, nothing is shrunk that need not be."""
    window = chosen(with_box(900, 1200, 500, 600, 520, 620))
    assert (window.height, window.width) == window.size == (64, 64)
    assert not window.native
    assert window.scale == 1.0


def test_object_and_all_shadows_are_inside_with_a_margin():
    mask = with_box(900, 1200, 400, 500, 600, 600)
    left, right = (with_box(900, 1200, 560, a, 590, b) for a, b in ((300, 500), (600, 780)))
    window = chosen(mask, left, right)
    margin = int(MARGIN * 480)
    assert window.left <= 300 - margin + 1
    assert window.left + window.width >= 780 + margin - 1
    assert window.top <= 400
    assert window.top + window.height >= 600
    assert window.height == window.width
    assert window.size == (64, 64)


def test_the_object_is_no_larger_than_renderers_are_trained_on():
    window = chosen(with_box(900, 1200, 300, 500, 700, 600))
    assert window.height == pytest.approx(400 / LARGEST_OBJECT, abs=1)


def test_what_hardly_is_a_shadow_does_not_widen_the_window():
    mask = with_box(900, 1200, 400, 500, 440, 540)
    faint = with_box(900, 1200, 0, 0, 900, 1200, value=0.09)
    assert chosen(mask, faint) == chosen(mask)


def test_window_ends_where_the_photograph_does():
    window = chosen(with_box(200, 1200, 0, 900, 200, 1200))
    assert (window.top, window.height) == (0, 200)
    assert window.left + window.width == 1200
    assert window.size[0] % MULTIPLE == window.size[1] % MULTIPLE == 0
    assert window.size[0] * window.size[1] == pytest.approx(SIZE**2, rel=0.2)


def test_with_nothing_to_look_at_it_is_the_photograph_shrunk():
    window = chosen(blank(600, 800), blank(600, 800))
    assert (window.top, window.left, window.height, window.width) == (0, 0, 600, 800)
    assert window.size == (56, 72)


@st.composite
def scenes(draw):
    """An object mask and a shadow, boxes in a frame of any size."""
    height, width = draw(st.integers(1, 300)), draw(st.integers(1, 300))
    masks = []
    for _ in range(2):
        top, left = draw(st.integers(0, height - 1)), draw(st.integers(0, width - 1))
        bottom, right = draw(st.integers(top + 1, height)), draw(st.integers(left + 1, width))
        masks.append(with_box(height, width, top, left, bottom, right))
    return masks


@given(scenes())
def test_any_window_holds_what_it_must(masks):
    window = chosen(*masks)
    height, width = window.frame
    rows, columns = np.nonzero(masks[0] + masks[1])
    assert 0 <= window.top <= rows.min()
    assert 0 <= window.left <= columns.min()
    assert rows.max() < window.top + window.height <= height
    assert columns.max() < window.left + window.width <= width
    for side, small in zip((window.height, window.width), window.size):
        assert 1 <= small <= side
        assert small == side or small % MULTIPLE == 0
    # A side is rounded to whole latents, a short one not below one of them.
    assert window.size[0] * window.size[1] <= max(1.3 * SIZE**2, MULTIPLE * max(window.size))


@pytest.fixture
def large():
    return make_scene(160, 240)


def half(scene, scale=2):
    height, width = scene.size
    return Window(0, 0, height, width, (height // scale, width // scale), scene.size)


def test_whole_photograph_is_the_scene_itself(large):
    assert look(large, Window.whole(large.size)) is large


def test_at_its_own_scale_a_window_is_a_crop(large):
    window = Window(10, 20, 64, 64, (64, 64), large.size)
    view = look(large, window)
    for name in ("background", "object_mask", "footprint_depth"):
        np.testing.assert_array_equal(getattr(view, name), window.crop(getattr(large, name)))
    np.testing.assert_array_equal(view.object_maps.depth, window.crop(large.object_maps.depth))
    np.testing.assert_allclose(
        view.object_maps.albedo, window.crop(large.object_maps.albedo), atol=1e-6
    )


def test_shrunken_maps_are_means_and_stay_premultiplied(large):
    view = look(large, half(large))

    def means(array):
        height, width = array.shape[:2]
        return array.reshape(height // 2, 2, width // 2, 2, -1).mean(axis=(1, 3)).squeeze()

    np.testing.assert_allclose(view.background, means(large.background), atol=1e-6)
    np.testing.assert_allclose(view.object_mask, means(large.object_mask), atol=1e-6)
    np.testing.assert_allclose(view.object_maps.depth, means(large.object_maps.depth), atol=1e-6)
    covered = view.object_mask > 0
    colour = view.object_maps.albedo[covered] / view.object_mask[covered][:, None]
    np.testing.assert_allclose(colour, np.broadcast_to([0.7, 0.3, 0.2], colour.shape), atol=1e-5)


def test_normals_keep_their_length(large):
    view = look(large, half(large, 4))
    floor = np.linalg.norm(view.background_maps.normal, axis=-1)
    np.testing.assert_allclose(floor, 1.0, atol=1e-5)
    thing = np.linalg.norm(view.object_maps.normal, axis=-1)
    np.testing.assert_allclose(thing, view.object_mask, atol=1e-5)


def test_contact_depth_is_the_mean_of_what_touches():
    scene = make_scene(16, 16)
    foot = blank(16, 16)
    foot[8:12, 8:12] = 3.0
    foot[8:12, 12] = 5.0  # a quarter of its 4×4 block: not enough
    scene = replace(scene, footprint_depth=foot)
    small = look(scene, half(scene, 4)).footprint_depth
    assert small[2, 2] == pytest.approx(3.0)
    assert np.count_nonzero(small) == 1


def test_a_contact_thinner_than_half_a_pixel_is_not_lost():
    scene = make_scene(16, 16)
    foot = blank(16, 16)
    foot[9, 4:8] = 3.0
    small = look(replace(scene, footprint_depth=foot), half(scene, 4)).footprint_depth
    assert small[2, 1] == pytest.approx(3.0)
    assert np.count_nonzero(small) == 1


def test_scene_without_optional_maps(large):
    bare = replace(large, footprint_depth=None, truth=None)
    bare = replace(bare, background_maps=replace(bare.background_maps, normal=None, depth=None))
    view = look(bare, half(bare))
    assert view.footprint_depth is None
    assert view.background_maps.normal is None
    assert view.background_maps.depth is None


def test_the_view_has_no_camera_of_its_own(large):
    view = look(large, half(large))
    assert view.field_of_view is None
    assert view.truth is None
    assert view.object_mesh is None
    assert view.ground is None


def test_shrinking_keeps_the_mean():
    shadow = make_shadow(make_scene(90, 150))
    assert shrink(shadow, (30, 50)).mean() == pytest.approx(shadow.mean(), rel=1e-5)


@pytest.mark.parametrize("size", [(32, 32), (64, 96), (300, 200)])
def test_a_coarse_window_is_a_tight_one_at_a_smaller_scale(size):
    mask = blank(*size)
    mask[size[0] // 2 : size[0] // 2 + 12, 5:20] = 1.0
    tight, coarse = chosen(mask, mode="tight"), chosen(mask, mode="coarse")
    assert (coarse.top, coarse.left) == (tight.top, tight.left)
    assert (coarse.height, coarse.width) == (tight.height, tight.width)
    assert coarse.size[0] * coarse.size[1] <= 1.3 * (COARSE * SIZE) ** 2
