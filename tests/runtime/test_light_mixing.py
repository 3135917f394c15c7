"""Several lights in one picture."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scenes import make_scene, make_shadow

from spotlight_runtime import GuidingShadow
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.imaging.colour import linear_to_srgb, srgb_to_linear
from spotlight_runtime.relighting.mixing import Mix

SHADOW = np.zeros((4, 4), np.float32)


def guide(value=0.0, weight=1.0, colour=(1.0, 1.0, 1.0), negative=None):
    return GuidingShadow(SHADOW + np.float32(value), negative, weight, colour)


def test_one_light_is_all_the_light_there_is():
    mix = Mix.of([guide(weight=0.0, colour=(1.0, 0.0, 0.0))])
    np.testing.assert_array_equal(mix.shares, np.ones((1, 3)))


def test_shares_are_weights_and_colours_by_channel():
    mix = Mix.of([guide(weight=1.0, colour=(1.0, 1.0, 0.0)), guide(weight=3.0)])
    np.testing.assert_allclose(mix.shares, [[0.25, 0.25, 0.0], [0.75, 0.75, 1.0]])


positive = st.floats(0.01, 100.0)


@given(
    st.lists(st.tuples(positive, st.tuples(positive, positive, positive)), min_size=1, max_size=6)
)
def test_every_channel_adds_up_to_one(lights):
    mix = Mix.of([guide(0.1, weight, colour) for weight, colour in lights])
    np.testing.assert_allclose(mix.shares.sum(axis=0), 1.0, rtol=1e-6)


def test_permuting_lights_changes_no_bit(rng):
    lights = [
        (guide(0.3, 1.0), rng.random((5, 7, 3), np.float32)),
        (guide(0.3, 1.7, (1.0, 0.5, 0.3)), rng.random((5, 7, 3), np.float32)),
        (guide(0.1, 1.0), rng.random((5, 7, 3), np.float32)),
        (guide(0.1, 1.0, negative=SHADOW), rng.random((5, 7, 3), np.float32)),
    ]
    sums = {
        Mix.of([g for g, _ in order]).sum([p for _, p in order]).tobytes()
        for order in permutations(lights)
    }
    assert len(sums) == 1


def test_a_channel_that_no_light_has_is_named():
    red = guide(colour=(1.0, 0.0, 0.0))
    with pytest.raises(InvalidInputError, match="got none in green, blue"):
        Mix.of([red, red])
    with pytest.raises(InvalidInputError, match="got none in red, green, blue"):
        Mix.of([guide(weight=0.0), guide(weight=0.0)])


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf, "1", None, True, 10**400])
def test_bad_weights_and_colours_are_named(bad):
    with pytest.raises(InvalidInputError, match="weight: expected a finite number"):
        guide(weight=bad)
    with pytest.raises(InvalidInputError, match="colour: expected a finite number"):
        guide(colour=(1.0, bad, 1.0))
    with pytest.raises(InvalidInputError, match="colour: expected red, green, blue"):
        guide(colour=(1.0, 1.0))
    with pytest.raises(InvalidInputError, match="colour: expected red, green, blue"):
        guide(colour=bad)


@pytest.mark.parametrize("colour", [[1.0, 0.5, 0], np.array([1.0, 0.5, 0.0], np.float32)])
def test_colours_may_come_as_lists_and_arrays(colour):
    made = guide(weight=np.float32(2.0), colour=colour)
    assert (made.weight, made.colour) == (2.0, (1.0, 0.5, 0.0))
    assert {type(number) for number in (made.weight, *made.colour)} == {float}
    Mix.of([made, guide(weight=2.0)])


@pytest.mark.parametrize("darkness", [{"weight": 0.0}, {"colour": (0.0, 0.0, 0.0)}])
def test_a_light_that_gives_none_is_left_out(relighter, pictures, darkness):
    scene, (left, right), alone, _ = pictures
    options = {"denoise": False, "steps": 2}
    dark = GuidingShadow(right.positive, **darkness)
    made = relighter.relight(scene, [left, dark], **options)
    assert made.image.tobytes() == alone[0].image.tobytes()
    assert (made.evaluations, made.report()["lights"]) == (alone[0].evaluations, 1)
    planned = relighter.prepare(scene, [left, dark], mixed=True, **options).plan
    assert planned.evaluations == made.evaluations
    each = relighter.relight_each(scene, [left, dark], **options)
    assert [e.image.tobytes() for e in each] == [e.image.tobytes() for e in alone]
    with pytest.raises(InvalidInputError, match="got none in red, green, blue"):
        relighter.relight(scene, [dark, dark], **options)


@pytest.fixture(scope="module")
def pictures(relighter):
    """Two lights alone, and together."""
    scene = make_scene(64, 96)
    lights = [
        GuidingShadow(make_shadow(scene, "left"), weight=3.0, colour=(1.0, 0.5, 0.25)),
        GuidingShadow(make_shadow(scene, "right"), weight=1.0),
    ]
    options = {"denoise": False, "steps": 2}
    return (
        scene,
        lights,
        relighter.relight_each(scene, lights, **options),
        relighter.relight(scene, lights, **options),
    )


def test_light_adds_up_in_linear_light(pictures):
    _, _, alone, together = pictures
    shares = np.array([[3.0, 1.5, 0.75], [1.0, 1.0, 1.0]])
    shares /= shares.sum(axis=0)
    wanted = sum(w * srgb_to_linear(p.image) for w, p in zip(shares, alone))
    np.testing.assert_allclose(srgb_to_linear(together.image), wanted, atol=1e-5)
    wanted = sum(w * srgb_to_linear(p.prediction) for w, p in zip(shares, alone))
    np.testing.assert_allclose(srgb_to_linear(together.prediction), wanted, atol=1e-5)


def test_two_lights_are_between_each_alone(pictures):
    """A shadow takes away its own light's share; where neither touches, no bit changes."""
    scene, _, alone, together = pictures
    first, second = (p.image for p in alone)
    assert (together.image >= np.minimum(first, second) - 1e-5).all()
    assert (together.image <= np.maximum(first, second) + 1e-5).all()
    kept = linear_to_srgb(scene.background)
    neither = (first == kept).all(axis=-1) & (second == kept).all(axis=-1)
    assert neither.mean() > 0.1
    np.testing.assert_array_equal(together.image[neither], kept[neither])


def test_lights_share_the_pass_without_shadow(pictures):
    _, lights, alone, together = pictures
    assert together.evaluations == 2 * (2 * len(lights) + 1)
    assert [p.evaluations for p in alone] == [6, 4]
    assert together.report()["lights"] == 2


def test_order_of_the_lights_does_not_matter(relighter, pictures):
    scene, lights, _, together = pictures
    turned = relighter.relight(scene, lights[::-1], denoise=False, steps=2)
    assert turned.image.tobytes() == together.image.tobytes()
    assert turned.prediction.tobytes() == together.prediction.tobytes()


def test_a_light_alone_is_what_it_is_by_itself(relighter, pictures):
    scene, lights, alone, _ = pictures
    single = relighter.relight(scene, lights[1], denoise=False, steps=2)
    assert single.image.tobytes() == alone[1].image.tobytes()
    assert single.no_shadow.tobytes() == alone[1].no_shadow.tobytes()
