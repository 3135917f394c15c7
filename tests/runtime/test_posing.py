"""Objects stand where they are put: on the floor, turned, sized, in the picture or not at all."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.models import box_arrays
from support.rooms import room_ground

from spotlight_runtime.composing.materials import Material
from spotlight_runtime.composing.posing import Placement, floor_point, pose_product, scaling
from spotlight_runtime.composing.product import Piece, assemble
from spotlight_runtime.errors import GroundError, InvalidInputError, PlacementError
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground

CAMERA = Camera(400, 300, 60.0)


def box(sides=(1.0, 2.0, 0.5), lift=0.7):
    """A box that hovers in its own file, off its axis."""
    vertices, faces = box_arrays(sides)
    return assemble([Piece(vertices + np.float32([3, lift, -2]), faces, Material())], "box")


def in_world(posed, ground):
    """Vertices as right, away, up over the floor."""
    return posed.vertices @ ground.world_axes().T.astype(np.float32) - [0, 0, ground.offset]


@given(
    x=st.floats(0.1, 0.9),
    y=st.floats(0.6, 0.95),
    pitch=st.floats(0.0, 40.0),
    height=st.floats(0.8, 3.0),
)
def test_floor_point_is_on_the_floor_and_appears_where_it_was_picked(x, y, pitch, height):
    ground = room_ground(height, pitch)
    point = floor_point(CAMERA, ground, (x, y))
    assert np.asarray(ground.normal) @ point == pytest.approx(ground.offset, rel=1e-6)
    px, py, depth = CAMERA.project(point[None])[0]
    assert (px, py) == pytest.approx((400 * x, 300 * y), abs=1e-3)
    assert depth > 0.0


@pytest.mark.parametrize("y", [0.0, 0.1, 0.19])
def test_above_the_horizon_there_is_no_floor(y):
    with pytest.raises(GroundError, match=r"on or above the horizon.*pick a lower point"):
        floor_point(CAMERA, room_ground(), (0.5, y))


def test_level_with_the_horizon_of_a_level_camera():
    with pytest.raises(GroundError):
        floor_point(CAMERA, Ground((0.0, 1.0, 0.0), -1.5), (0.5, 0.5))


@given(yaw=st.floats(-360, 360), x=st.floats(0.35, 0.65), y=st.floats(0.5, 0.7))
def test_posed_object_rests_on_the_floor_around_its_point(yaw, x, y):
    ground = room_ground()
    product = box()
    posed = pose_product(product, Placement((x, y), yaw), CAMERA, ground)
    world = in_world(posed, ground)
    assert world[:, 2].min() == pytest.approx(0.0, abs=1e-5)
    assert world[:, 2].max() == pytest.approx(2.0, rel=1e-5)
    foot = floor_point(CAMERA, ground, (x, y)) @ ground.world_axes().T
    low = world[world[:, 2] < 1e-3, :2]
    middle = np.unique(low.round(4), axis=0).mean(axis=0)
    np.testing.assert_allclose(middle, foot[:2], atol=2e-4)


def test_front_faces_the_camera_and_turns_counter_clockwise():
    ground = room_ground()
    product = box((0.2, 0.2, 1.0), lift=0.0)
    front = product.vertices[:, 2] > product.vertices[:, 2].mean()
    for yaw, toward in ((0.0, (0, -1)), (90.0, (1, 0)), (180.0, (0, 1)), (270.0, (-1, 0))):
        posed = pose_product(product, Placement((0.5, 0.6), yaw), CAMERA, ground)
        world = in_world(posed, ground)
        ahead = np.unique(world[front].round(4), axis=0).mean(axis=0)
        ahead -= np.unique(world.round(4), axis=0).mean(axis=0)
        np.testing.assert_allclose(ahead[:2] / np.linalg.norm(ahead), toward, atol=1e-3)


def test_the_right_of_the_model_is_on_the_right():
    posed = pose_product(box(), Placement((0.5, 0.6)), CAMERA, room_ground())
    order = np.argsort(box().vertices[:, 0])
    across = posed.vertices[order, 0]
    assert across[:4].max() < across[-4:].min()


def test_normals_turn_with_the_object_and_keep_their_length():
    posed = pose_product(box(), Placement((0.5, 0.6), 37.0), CAMERA, room_ground())
    np.testing.assert_allclose(np.linalg.norm(posed.normals, axis=1), 1.0, atol=1e-5)
    points = posed.vertices[posed.faces].astype(np.float64)
    flat = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(posed.normals[posed.faces[:, 0]], flat, atol=1e-4)


@pytest.mark.parametrize(
    ("placement", "factor"),
    [
        (Placement((0.5, 0.5)), 1.0),
        (Placement((0.5, 0.5), size=1.0), 0.5),
        (Placement((0.5, 0.5), height=3.0), 1.5),
    ],
)
def test_size_height_or_the_models_own(placement, factor):
    assert scaling(placement, [1.0, 2.0, 0.5]) == factor


def test_flat_object_has_no_height_to_scale():
    with pytest.raises(InvalidInputError, match="flat"):
        scaling(Placement((0.5, 0.5), height=1.0), [1.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("field", "value"),
    [("size", 0.0), ("size", -1.0), ("height", math.nan), ("size", math.inf), ("yaw", math.nan)],
)
def test_impossible_numbers(field, value):
    with pytest.raises(InvalidInputError, match=field):
        Placement((0.5, 0.5), **{field: value})


def test_size_and_height_exclude_each_other():
    with pytest.raises(InvalidInputError, match="size or a height, got both"):
        Placement((0.5, 0.5), size=1.0, height=1.0)


@pytest.mark.parametrize("at", [(-0.1, 0.5), (0.5, 1.2), (math.nan, 0.5)])
def test_point_outside_the_picture(at):
    with pytest.raises(PlacementError, match=r"at: .*inside the picture"):
        Placement(at)


def test_object_that_reaches_behind_the_camera():
    with pytest.raises(PlacementError, match=r"box: .*behind the camera.*smaller"):
        pose_product(box(), Placement((0.5, 0.95), size=12.0), CAMERA, room_ground())


def test_places_shared_in_the_model_are_shared_in_the_picture(rng):
    vertices, faces = box_arrays((1.0, 1.0, 1.0))
    spread = assemble([Piece(vertices, faces, Material())], "box")
    posed = pose_product(spread, Placement((0.5, 0.6), 12.3), CAMERA, room_ground())
    assert len(np.unique(posed.vertices, axis=0)) == 8
