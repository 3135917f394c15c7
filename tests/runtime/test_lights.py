"""Lights: what can be said of one, and where it then stands."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import shadow_scenes as known

from spotlight_runtime.errors import InvalidInputError, LightError
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.shadows.placement import box_of, place_light

GROUND = known.floor()
CENTRE = known.ball_centre(GROUND)
BALL = known.sphere_mesh(CENTRE, known.RADIUS)
BOX = box_of(BALL, GROUND)
SIZE = 2 * known.RADIUS


def place(light, ground=GROUND):
    return place_light(light, BOX, BALL, ground)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({}, "azimuth and elevation in degrees, or a position"),
        ({"azimuth": 10}, "elevation None"),
        ({"azimuth": math.nan, "elevation": 20}, "azimuth: expected a finite number"),
        ({"azimuth": 10, "elevation": 91}, "elevation: expected a finite number from -90 to 90"),
        ({"azimuth": 10, "elevation": 20, "radius": -1}, "radius"),
        ({"azimuth": 10, "elevation": 20, "radius": math.inf}, "radius"),
        ({"azimuth": 10, "elevation": 20, "distance": 0.0}, "distance: expected .* above 0"),
        ({"azimuth": 10, "elevation": 20, "distance": None, "radius": 80}, "directional"),
        ({"azimuth": 10, "elevation": 20, "position": (1, 2, 3)}, "got both"),
        ({"position": (1, 2)}, "position: expected x, y, z"),
        ({"position": (1, 2, math.inf)}, "position"),
        ({"azimuth": 1, "elevation": 2, "frame": "object"}, "frame: expected world or camera"),
        ({"azimuth": 1, "elevation": 2, "weight": -0.1}, "weight"),
        ({"azimuth": 1, "elevation": 2, "colour": (1, 1)}, "colour: expected red, green, blue"),
        ({"azimuth": 1, "elevation": 2, "colour": (1, -1, 1)}, "colour"),
        ({"azimuth": "135", "elevation": 45}, "azimuth: expected a finite number .*, got '135'"),
        ({"azimuth": 135, "elevation": True}, "elevation: expected a finite number .*, got True"),
        ({"azimuth": 10**400, "elevation": 45}, "azimuth: expected a finite number"),
        ({"azimuth": 1, "elevation": 2, "radius": None}, "radius: expected a finite number"),
        ({"azimuth": 1, "elevation": 2, "colour": 1.0}, "colour: expected red, green, blue"),
        ({"azimuth": 1, "elevation": 2, "colour": "red"}, "colour: expected a finite number"),
        ({"position": 3.0}, "position: expected x, y, z"),
        ({"position": (1, 2, "3")}, "position: expected a finite number"),
    ],
)
def test_impossible_lights_are_named(arguments, named):
    with pytest.raises(InvalidInputError, match=named):
        Light(**arguments)


def test_numbers_of_a_light_are_pythons_own():
    light = Light(np.int64(30), np.float32(45), colour=[1, 0.5, 0], weight=np.float64(2))
    assert light == Light(30.0, 45.0, colour=(1.0, 0.5, 0.0), weight=2.0)
    numbers = (light.azimuth, light.elevation, light.weight, *light.colour)
    assert {type(number) for number in numbers} == {float}
    assert Light(position=np.arange(3)).position == (0.0, 1.0, 2.0)
    assert light.opposite().azimuth == 210.0


@pytest.mark.parametrize(
    ("azimuth", "elevation", "towards"),
    [
        (0, 0, (1, 0, 0)),
        (90, 0, (0, 1, 0)),
        (180, 0, (-1, 0, 0)),
        (270, 45, (0, -(0.5**0.5), 0.5**0.5)),
    ],
)
def test_azimuth_turns_from_right_to_away(azimuth, elevation, towards):
    placed = place(Light(azimuth, elevation, distance=3.0))
    offset = GROUND.world_axes() @ (placed.centre - CENTRE) / (3.0 * SIZE)
    np.testing.assert_allclose(offset, towards, atol=1e-3)
    assert placed.radius == pytest.approx(SIZE, rel=1e-3)
    assert not placed.directional


def test_a_directional_light_has_a_direction_and_an_angle():
    placed = place(Light(30, 50, radius=2.0, distance=None))
    np.testing.assert_allclose(placed.centre, known.light_direction(GROUND, 30, 50), atol=1e-9)
    assert placed.directional
    assert placed.radius == pytest.approx(math.tan(math.radians(2.0)))


def test_positions_in_both_frames():
    world = place(Light(position=(1.0, 2.0, 3.0), radius=0.5))
    axes = GROUND.world_axes()
    foot = CENTRE - known.RADIUS * axes[2]
    np.testing.assert_allclose(world.centre, foot + np.array([1.0, 2.0, 3.0]) @ axes, atol=1e-3)
    camera = place(Light(position=(0.5, 2.0, -1.0), frame="camera"))
    np.testing.assert_array_equal(camera.centre, [0.5, 2.0, -1.0])
    assert camera.radius == pytest.approx(SIZE, rel=1e-3)


def test_the_camera_frame_is_level_with_the_camera():
    placed = place(Light(90, 0, distance=None, frame="camera"), ground=None)
    np.testing.assert_allclose(placed.centre, [0.0, 0.0, -1.0], atol=1e-12)
    placed = place(Light(0, 90, distance=None, frame="camera"), ground=None)
    np.testing.assert_allclose(placed.centre, [0.0, 1.0, 0.0], atol=1e-12)


@given(
    st.one_of(
        st.builds(Light, st.floats(-720, 720), st.floats(5, 85), distance=st.floats(3, 20)),
        st.builds(Light, st.floats(0, 360), st.floats(5, 85), distance=st.none()),
        st.builds(
            Light,
            position=st.tuples(st.floats(2, 9), st.floats(2, 9), st.floats(3, 9)),
            frame=st.sampled_from(["world", "camera"]),
            radius=st.just(0.1),
        ),
    )
)
def test_the_opposite_light_is_half_a_turn_away(light):
    opposite = light.opposite()
    axes = GROUND.world_axes()
    here, there = place(light), place(opposite)
    middle = np.zeros(3) if here.directional else axes @ CENTRE
    first, second = axes @ here.centre - middle, axes @ there.centre - middle
    np.testing.assert_allclose(second, first * [-1, -1, 1], atol=2e-3)
    np.testing.assert_allclose(place(opposite.opposite()).centre, here.centre, atol=1e-9)
    assert there.radius == here.radius


@pytest.mark.parametrize(
    "light",
    [
        Light(0, -10),
        Light(120, -5, distance=None),
        Light(0, 0, distance=None),
        Light(position=(2.0, 0.0, -0.1)),
    ],
)
def test_a_light_below_the_floor_is_refused(light):
    with pytest.raises(LightError, match=r"above the floor.*raise its elevation"):
        place(light)


def test_below_the_floor_is_not_known_without_one():
    assert place(Light(0, -10, frame="camera"), ground=None).radius > 0


@pytest.mark.parametrize(
    ("light", "inside"),
    [
        (Light(position=(0.0, 0.0, known.RADIUS), radius=0.0), True),  # its middle
        (Light(position=(0.0, 0.0, 1.9 * known.RADIUS), radius=0.0), True),
        (Light(position=(0.0, 0.0, 2.2 * known.RADIUS), radius=0.0), False),
        (Light(position=(0.0, 0.0, 2.2 * known.RADIUS), radius=0.2), True),  # reaches into it
        (Light(position=(1.0, 0.0, 0.5), radius=0.7), False),
        (Light(position=(1.0, 0.0, 0.5), radius=0.8), True),
        (Light(45, 45, distance=1.0, radius=0.45), False),
        (Light(45, 45, distance=1.0, radius=0.55), True),
        # In a corner of the bounding box, where the ball is not.
        (Light(position=(0.35, 0.35, 0.75), radius=0.0), False),
    ],
)
def test_a_light_in_the_object_is_refused(light, inside):
    if inside:
        with pytest.raises(LightError, match="reaches into it"):
            place(light)
    else:
        assert place(light).radius >= 0.0
