"""Lights and arrays as guiding shadows, of photographs of any size."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support import shadow_scenes
from support.scenes import make_scene, make_shadow
from support.shadow_scenes import ball_scene

from spotlight_runtime import GuidingShadow, Light
from spotlight_runtime.errors import (
    DtypeError,
    InvalidInputError,
    LightError,
    ShadowWarning,
    ShapeError,
)
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.relighting.casting import MOST_PIXELS, megapixel
from spotlight_runtime.relighting.guides import guiding_shadows

SIDE = Light(azimuth=0.0, elevation=40.0)
BEHIND = Light(azimuth=90.0, elevation=40.0)


@pytest.fixture(scope="module")
def scene():
    return make_scene(24, 32)


@pytest.fixture(scope="module")
def shadow(scene):
    return make_shadow(scene)


@pytest.fixture(scope="module")
def ball():
    pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")
    return ball_scene(96)


@pytest.mark.parametrize("negative", [None, "none"])
def test_a_ready_shadow_contrasts_with_none(scene, shadow, negative):
    (guide,) = guiding_shadows(scene, shadow, negative)
    assert guide.positive is shadow
    assert guide.negative is None


def test_a_ready_shadow_with_a_ready_negative(scene, shadow):
    (guide,) = guiding_shadows(scene, shadow, np.zeros_like(shadow))
    assert not guide.negative.any()


def test_guiding_shadows_are_taken_as_they_are(scene, shadow):
    given = [GuidingShadow(shadow, weight=2.0), GuidingShadow(shadow, shadow)]
    assert guiding_shadows(scene, given) == tuple(given)


@pytest.mark.parametrize(
    ("guide", "negative", "named"),
    [
        ([], None, "lights: expected at least one"),
        ("shadow", "opposite", "the opposite of a ready shadow is not known"),
        (
            "shadow",
            "upside",
            "negative: expected opposite, none, a light or a shadow, got 'upside'",
        ),
        ("guiding", "none", "expected none beside a GuidingShadow"),
        ("two", "shadow", "negative: expected opposite or none for several lights"),
    ],
)
def test_what_does_not_go_together_is_named(scene, shadow, guide, negative, named):
    words = {"shadow": shadow, "guiding": GuidingShadow(shadow), "two": [shadow, shadow]}
    guide = words.get(guide, guide) if isinstance(guide, str) else guide
    negative = words.get(negative, negative)
    with pytest.raises(InvalidInputError, match=named):
        guiding_shadows(scene, guide, negative)


@pytest.mark.parametrize("guide", [3.0, "left.png", None, [[0.0, 1.0]]])
def test_what_is_no_light_is_named(scene, guide):
    with pytest.raises(DtypeError, match="shadow: expected a light or a float32 array"):
        guiding_shadows(scene, [guide])


def test_the_wrong_one_of_several_is_named(scene, shadow):
    with pytest.raises(ShapeError, match="shadow 2: expected shape"):
        guiding_shadows(scene, [shadow, shadow[:-1]])
    with pytest.raises(ShapeError, match="negative 2: expected shape"):
        guiding_shadows(scene, [shadow, GuidingShadow(shadow, shadow[:-1])])


def test_a_light_contrasts_with_its_opposite(ball):
    (guide,) = guiding_shadows(ball, SIDE)
    (across,) = guiding_shadows(ball, SIDE.opposite())
    np.testing.assert_array_equal(guide.negative, across.positive)
    left, right = guide.positive[:, :48].sum(), guide.positive[:, 48:].sum()
    assert left > 10 * right, "the light is on the right"


def test_negative_of_a_light_is_to_choose(ball):
    (none,) = guiding_shadows(ball, SIDE, "none")
    (other,) = guiding_shadows(ball, SIDE, BEHIND)
    (drawn,) = guiding_shadows(ball, SIDE, other.positive)
    (behind,) = guiding_shadows(ball, BEHIND, "opposite")
    assert none.negative is None
    np.testing.assert_array_equal(other.negative, behind.positive)
    assert drawn.negative is other.positive


def test_a_ready_shadow_may_contrast_with_a_light(ball):
    (guide,) = guiding_shadows(ball, np.zeros(ball.size, np.float32), SIDE)
    (cast,) = guiding_shadows(ball, SIDE)
    np.testing.assert_array_equal(guide.negative, cast.positive)


def test_weight_and_colour_come_along(ball):
    light = Light(azimuth=0.0, elevation=40.0, weight=2.0, colour=(1.0, 0.5, 0.2))
    (guide,) = guiding_shadows(ball, light)
    assert (guide.weight, guide.colour) == (2.0, (1.0, 0.5, 0.2))


@pytest.fixture(scope="module")
def lopsided(ball):
    """A ball and a marble beside it: the middle of both is between them."""
    offset = np.array([1.2, 0.0, 0.05 - shadow_scenes.RADIUS])
    centre = shadow_scenes.ball_centre(ball.ground) + offset @ ball.ground.world_axes()
    large, small = ball.object_mesh, shadow_scenes.sphere_mesh(centre, 0.05, rings=12)
    both = ObjectMesh(
        np.concatenate([large.vertices, small.vertices]),
        np.concatenate([large.faces, small.faces + len(large.vertices)]),
    )
    return replace(ball, object_mesh=both)


NEAR = Light(position=(0.425, 0.0, 0.5), radius=0.0)
"""Right of the ball; half a turn round the middle of ball and marble is in the ball."""


def test_where_the_light_opposite_has_no_place_there_is_no_negative(lopsided):
    with pytest.warns(ShadowWarning, match="there is no place for the light opposite"):
        (guide,) = guiding_shadows(lopsided, NEAR)
    assert guide.negative is None
    assert guide.positive.any()
    with pytest.raises(LightError, match=r'^negative: the opposite light: .* \(negative "none"\)'):
        guiding_shadows(lopsided, NEAR, "opposite")
    (asked,) = guiding_shadows(lopsided, NEAR, "none")
    np.testing.assert_array_equal(asked.positive, guide.positive)
    with pytest.raises(LightError, match=r"^light: expected a place outside the object"):
        guiding_shadows(lopsided, NEAR.opposite())


def test_an_unseen_shadow_is_said_of_the_light_that_was_asked_for_only(ball):
    """From the front the ball hides its shadow; that is no news of the opposite light's."""
    height = np.degrees(np.arctan2(shadow_scenes.HEIGHT - shadow_scenes.RADIUS, shadow_scenes.AWAY))
    front = Light(azimuth=270.0, elevation=float(height), radius=0.0, distance=None)
    with pytest.warns(ShadowWarning, match="light at azimuth 270°: "):
        guiding_shadows(ball, front)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        guiding_shadows(ball, front.opposite())


def test_a_megapixel_is_cast_on_as_it_is(ball):
    assert megapixel(ball) is ball


@pytest.fixture(scope="module")
def large():
    pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")
    return ball_scene(1500)


def test_more_is_cast_on_a_megapixel_of_the_same_geometry(large):
    small = megapixel(large)
    assert small.size[0] * small.size[1] <= 1.01 * MOST_PIXELS
    assert small.object_mesh is large.object_mesh
    assert small.ground is large.ground
    assert small.camera.field_of_view == large.camera.field_of_view


def test_a_large_shadow_is_the_small_one_magnified_without_a_hole(large):
    from spotlight_runtime.shadows.shadow import cast_shadow

    (guide,) = guiding_shadows(large, SIDE, "none")
    exact = cast_shadow(large, SIDE)
    assert guide.positive.dtype == np.float32
    assert 0.0 <= guide.positive.min() <= guide.positive.max() <= 1.0
    assert not guide.positive[large.object_mask == 1].any()
    assert np.abs(guide.positive - exact).mean() < 2e-3
    beside = cv2.dilate(large.object_mask, np.ones((7, 7))) - large.object_mask > 0
    assert np.abs(guide.positive - exact)[beside].mean() < 0.05
