"""The floor: found in depth and normals, or given by two clicks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.shadow_scenes import floor, floor_depth

from spotlight_runtime.errors import GroundError, InvalidInputError
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground, fit_ground, ground_from_clicks, normals_of

CAMERA = Camera(96, 64, 60.0)


def room(ground, camera=CAMERA, wall=6.0):
    """Depth and normals of a floor that ends at a wall ``wall`` metres ahead."""
    axes = ground.world_axes()
    depth = floor_depth(camera, ground)
    ahead = camera.rays() @ axes[1].astype(np.float32)
    behind = np.where(ahead > 1e-3, wall / np.maximum(ahead, 1e-3), 20.0)
    on_floor = depth < behind
    normal = np.where(on_floor[..., None], axes[2], -axes[1]).astype(np.float32)
    return np.minimum(depth, behind).astype(np.float32), normal


def angle_between(first, second):
    return np.rad2deg(np.arccos(np.clip(np.dot(first, second), -1, 1)))


@given(st.floats(10, 60), st.floats(0.3, 2.0), st.floats(-8, 8), st.booleans())
def test_a_clean_floor_is_found_exactly(pitch, height, roll, with_normals):
    up = floor(pitch, height).normal
    turn = np.deg2rad(roll)
    rolled = [np.sin(turn) * up[1], np.cos(turn) * up[1], up[2]]
    ground = Ground(tuple(float(v) for v in rolled), -height)
    depth, normal = room(ground)
    found = fit_ground(CAMERA, depth, normal if with_normals else None)
    assert angle_between(found.normal, ground.normal) < 0.1
    assert found.offset == pytest.approx(-height, rel=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_noise_furniture_and_wrong_normals_are_survived(seed):
    rng = np.random.default_rng(seed)
    ground = floor(20.0, 1.6)
    depth, normal = room(ground)
    depth *= rng.normal(1.0, 0.01, depth.shape).astype(np.float32)
    normal = normal + rng.normal(0.0, 0.15, normal.shape).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    clutter = rng.random(depth.shape) < 0.3
    depth[clutter] *= rng.uniform(0.3, 0.9, int(clutter.sum())).astype(np.float32)
    found = fit_ground(CAMERA, depth, normal)
    assert angle_between(found.normal, ground.normal) < 0.7
    assert found.offset == pytest.approx(ground.offset, rel=0.015)
    assert fit_ground(CAMERA, depth, normal) == found


def test_large_pictures_are_thinned():
    camera = Camera(900, 600, 60.0)
    ground = floor(25.0, 1.2)
    found = fit_ground(camera, *room(ground, camera))
    assert angle_between(found.normal, ground.normal) < 0.1


def test_a_mask_says_where_the_floor_may_be():
    """The upper part of the picture is a large table, the floor is what the mask leaves."""
    table, ground = floor(30.0, 0.7), floor(30.0, 1.5)
    depth = floor_depth(CAMERA, table)
    lower = np.arange(64)[:, None] >= 40
    lower = np.broadcast_to(lower, depth.shape)
    depth = np.where(lower, floor_depth(CAMERA, ground), depth)
    normal = np.broadcast_to(np.float32(ground.normal), (64, 96, 3))
    assert fit_ground(CAMERA, depth, normal).offset == pytest.approx(-0.7, rel=0.01)
    assert fit_ground(CAMERA, depth, normal, lower).offset == pytest.approx(-1.5, rel=0.01)


@pytest.mark.parametrize("picture", ["wall", "sky", "unknown", "ceiling", "little"])
def test_no_floor_is_said_with_a_remedy(picture):
    depth = np.full((64, 96), 4.0, np.float32)
    normal = np.zeros((64, 96, 3), np.float32)
    normal[..., 2] = 1.0
    if picture == "unknown":
        depth[:] = 0.0
    elif picture == "ceiling":
        normal[:] = [0.0, -1.0, 0.0]
        depth = floor_depth(CAMERA, floor(0.0))[::-1].copy()
    elif picture == "little":
        ground = floor(10.0)
        depth[-1:] = floor_depth(CAMERA, ground)[-1:]
        normal[-1:] = ground.normal
    with pytest.raises(GroundError, match="horizon and a point of contact"):
        fit_ground(CAMERA, depth, normal)


@given(st.floats(-20, 60), st.floats(0.2, 3.0))
def test_two_clicks_give_the_floor(pitch, height):
    ground = floor(pitch, height)
    horizon = 0.5 * CAMERA.height - CAMERA.focal * np.tan(np.deg2rad(pitch))
    point = np.array([[0.4, 3.0, -height]]) @ ground.world_axes()
    x, y, depth = CAMERA.project(point)[0]
    by_height = ground_from_clicks(CAMERA, horizon, (x, y), camera_height=height)
    by_depth = ground_from_clicks(CAMERA, horizon, (x, y), contact_depth=depth)
    for found in (by_height, by_depth):
        np.testing.assert_allclose(found.normal, ground.normal, atol=1e-6)
        assert found.offset == pytest.approx(-height, rel=1e-5)


def test_clicks_without_a_length_take_eye_level():
    assert ground_from_clicks(CAMERA, 20.0, (10.0, 50.0)).offset == -1.6


def test_impossible_clicks():
    with pytest.raises(GroundError, match="below the horizon"):
        ground_from_clicks(CAMERA, 20.0, (10.0, 20.0))
    with pytest.raises(InvalidInputError, match="got both"):
        ground_from_clicks(CAMERA, 20.0, (10.0, 30.0), camera_height=1.0, contact_depth=2.0)
    with pytest.raises(InvalidInputError, match="positive length"):
        ground_from_clicks(CAMERA, 20.0, (10.0, 30.0), camera_height=0.0)


@given(st.floats(-85, 85), st.floats(-180, 180))
def test_world_axes_are_a_right_handed_frame(pitch, roll):
    p, r = np.deg2rad([pitch, roll])
    normal = (float(np.sin(r) * np.cos(p)), float(np.cos(r) * np.cos(p)), float(np.sin(p)))
    axes = Ground(normal, -1.0).world_axes()
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.cross(axes[0], axes[1]), axes[2], atol=1e-9)
    np.testing.assert_allclose(axes[2], normal, atol=1e-9)


def test_world_axes_look_where_the_camera_looks():
    axes = floor(30.0).world_axes()
    np.testing.assert_allclose(axes[0], [1.0, 0.0, 0.0], atol=1e-12)
    assert axes[1] @ [0.0, 0.0, -1.0] == pytest.approx(np.cos(np.deg2rad(30.0)))
    rolled = Ground((1.0, 0.0, 0.0), -1.0).world_axes()
    np.testing.assert_allclose(rolled @ rolled.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("normal", [(0.0, 2.0, 0.0), (0.0, 0.0, 0.0), (float("nan"), 1.0, 0.0)])
def test_a_ground_has_a_unit_normal(normal):
    with pytest.raises(InvalidInputError, match="length 1"):
        Ground(normal, -1.0)


def test_a_ground_has_a_finite_offset():
    with pytest.raises(InvalidInputError, match="offset"):
        Ground((0.0, 1.0, 0.0), float("inf"))


def test_normals_do_not_mix_the_sides_of_an_edge():
    ground = floor(25.0)
    depth, normal = room(ground, wall=3.0)
    got = normals_of(CAMERA.unproject(depth))
    agree = np.einsum("hwc,hwc->hw", got, normal)[depth < 15.0]
    assert (agree > 0.999).mean() > 0.96


def test_normals_of_a_line_of_pixels_face_the_camera():
    got = normals_of(Camera(5, 1).unproject(np.full((1, 5), 2.0, np.float32)))
    np.testing.assert_array_equal(got, np.broadcast_to([0.0, 0.0, 1.0], (1, 5, 3)))
