"""What a plan leaves out changes nothing, and what it says it runs is what runs."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.onnx_backbone import write_backbone
from support.scenes import make_scene, make_shadow
from support.shadow_scenes import ball_scene

from spotlight_runtime import GuidingShadow, Light, Relighter, RelightOptions
from spotlight_runtime.scenes.scene import MAP_NAMES

SCENES = range(10)
SIZES = ((64, 96), (40, 72), (51, 45))


class Counted:
    """A relighter that counts the calls of its networks."""

    def __init__(self, relighter, remember=0):
        self.calls = Counter()
        known = relighter._networks
        networks = {name: self._counting(name, known[name]) for name in known}
        self.relighter = Relighter(relighter.spec, networks, remember=remember)

    def _counting(self, name, network):
        def call(**arrays):
            self.calls[name] += 1
            return network(**arrays)

        return call

    def relight(self, *args, **kwargs):
        self.calls.clear()
        return self.relighter.relight(*args, **kwargs)


@pytest.fixture(scope="module")
def counted(relighter):
    return Counted(relighter)


@pytest.fixture(scope="module")
def reusing(tmp_path_factory):
    """One whose backbone brings a shallow graph."""
    folder = write_backbone(tmp_path_factory.mktemp("models") / "deep", deep=True)
    return Counted(Relighter.load(folder, threads=1, remember=0))


def case(number):
    scene = make_scene(*SIZES[number % len(SIZES)], seed=number)
    return scene, make_shadow(scene, "left"), make_shadow(scene, "right")


def without_object(scene):
    gone = {name: np.zeros_like(getattr(scene.object_maps, name)) for name in MAP_NAMES}
    return replace(
        scene,
        object_mask=np.zeros_like(scene.object_mask),
        object_maps=replace(scene.object_maps, **gone),
        footprint_depth=None,
    )


def faint(shadow):
    """So thin that it hides shading, but reaches no latent's centre."""
    thin = np.zeros_like(shadow)
    thin[0, 0] = 1.0
    return thin


RULES = {
    "γ = 1 has no negative branch": (
        lambda scene, left, right: (scene, GuidingShadow(left, right)),
        {"gamma": 1.0},
        {"denoiser": 4, "condition_encoder": 1, "vae_encoder": 1},
    ),
    "no object has nothing to guide": (
        lambda scene, left, right: (without_object(scene), GuidingShadow(left, right)),
        {},
        {"denoiser": 4, "condition_encoder": 1, "vae_encoder": 1},
    ),
    "equal shadows contrast nothing": (
        lambda scene, left, right: (scene, GuidingShadow(left, left)),
        {},
        {"denoiser": 4, "condition_encoder": 1, "vae_encoder": 1},
    ),
    "β = 0 encodes nothing": (
        lambda scene, left, right: (scene, GuidingShadow(left, right)),
        {"beta": 0.0},
        {"vae_encoder": 2},
    ),
    "an empty negative is not encoded": (
        lambda scene, left, right: (scene, GuidingShadow(left)),
        {},
        {"vae_encoder": 1},
    ),
    "a shadow that covers no latent is not encoded": (
        lambda scene, left, right: (scene, GuidingShadow(faint(left), right)),
        {},
        {"vae_encoder": 1},
    ),
    "one step blends nothing": (
        lambda scene, left, right: (scene, GuidingShadow(left, right)),
        {"steps": 1},
        {"vae_encoder": 2},
    ),
    "no shadow and no guidance is the pass without shadow": (
        lambda scene, left, right: (scene, GuidingShadow(np.zeros_like(left))),
        {},
        {"denoiser": 8, "condition_encoder": 2, "vae_encoder": 2, "vae_decoder": 1},
    ),
}
"""Scene and light of a case, options, and the calls that the rule saves."""
PAPER_ONLY = {"equal shadows contrast nothing"}
"""The release draws each branch's latents anew: there, equal shadows differ."""


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("fidelity", ["paper", "release"])
def test_what_an_exact_rule_leaves_out_changes_no_bit(counted, rule, fidelity):
    build, changes, saved = RULES[rule]
    options = RelightOptions(denoise=False, fidelity=fidelity, **changes)
    for number in SCENES:
        scene, light = build(*case(number))
        everything = counted.relight(scene, light, options=options, skip=False)
        calls = Counter(counted.calls)
        planned = counted.relight(scene, light, options=options)
        np.testing.assert_array_equal(planned.image, everything.image)
        np.testing.assert_array_equal(planned.prediction, everything.prediction)
        np.testing.assert_array_equal(planned.no_shadow, everything.no_shadow)
        void = fidelity == "release" and rule in PAPER_ONLY
        assert dict(calls - counted.calls) == ({} if void else saved)
        assert all(effect.exact for effect in planned.plan.effects) == ("steps" not in changes)


def test_lights_share_the_pass_without_shadow_across_relights(relighter):
    counted = Counted(relighter, remember=2**20)
    for number in SCENES:
        scene, left, right = case(number)
        lights = (GuidingShadow(left, right), GuidingShadow(right, left))
        first, second = (counted.relight(scene, light, denoise=False) for light in lights)
        assert second.plan.plain.source == "remembered"
        assert counted.calls["denoiser"] == second.evaluations == first.evaluations - 4
        again = relighter.relight(scene, lights[1], denoise=False)
        np.testing.assert_array_equal(second.image, again.image)
        other = counted.relight(scene, lights[0], denoise=False, seed=1)
        assert other.evaluations == first.evaluations


def test_what_is_remembered_is_bounded_and_read_only(relighter):
    picture = 64 * 96 * 3 * 4
    small = Relighter(relighter.spec, relighter._networks, remember=2 * picture)
    results = []
    for seed in (1, 2, 3, 1, 3):
        scene, left, _ = case(0)
        results.append(small.relight(scene, left, denoise=False, seed=seed))
        assert small._remembered.bytes <= 2 * picture
    assert [r.plan.plain.source for r in results] == ["run", "run", "run", "run", "remembered"]
    with pytest.raises(ValueError, match="read-only"):
        small._remembered.get(small.prepare(scene, left, denoise=False, seed=3).plain_key)[...] = 0


@st.composite
def requests(draw):
    """Any scene, lights and options."""
    scene, left, right = case(draw(st.integers(0, 9)))
    if draw(st.booleans()):
        scene = without_object(scene)
    nothing = np.zeros_like(left)
    shadows = st.sampled_from([left, right, nothing, faint(left), np.ones_like(left)])
    guides = st.builds(GuidingShadow, shadows, st.none() | shadows)
    lights = draw(st.lists(guides, min_size=1, max_size=3))
    low, high = sorted(draw(st.tuples(st.floats(0, 1), st.floats(0, 1))))
    options = RelightOptions(
        gamma=draw(st.sampled_from([0.0, 1.0, 3.0])),
        beta=draw(st.sampled_from([0.0, 0.05])),
        steps=draw(st.integers(1, 6)),
        plain_steps=draw(st.none() | st.integers(1, 6)),
        solver=draw(st.sampled_from(["ddim", "dpmpp_2m", "unipc"])),
        guidance_interval=(low, high),
        reuse=draw(st.integers(1, 4)),
        batch_branches=draw(st.booleans()),
        window=draw(st.sampled_from(["auto", "frame", "tight", "coarse"])),
        fidelity=draw(st.sampled_from(["paper", "release"])),
        skip=draw(st.booleans()),
        denoise=False,
    )
    return scene, lights, options


@given(requests())
def test_predicted_calls_are_the_calls_made(counted, request):
    scene, lights, options = request
    planned = counted.relighter.prepare(scene, lights, options=options).plan
    result = counted.relight(scene, lights, options=options)
    assert dict(counted.calls) == planned.calls() == result.plan.calls()
    if not options.batch_branches:
        assert counted.calls["denoiser"] == planned.evaluations
    assert sum(effect.evaluations for effect in planned.effects) == planned.evaluations


@given(requests())
def test_predicted_calls_of_one_picture_a_light(counted, request):
    scene, lights, options = request
    planned = counted.relighter.prepare(scene, lights, options=options).plan
    counted.calls.clear()
    results = counted.relighter.relight_each(scene, lights, options=options)
    total = Counter()
    for result in results:
        total.update(result.plan.calls())
    assert total == counted.calls
    assert dict(counted.calls) == planned.calls()
    assert sum(result.evaluations for result in results) == planned.evaluations


@given(requests())
def test_predicted_calls_are_the_calls_made_with_features_reused(reusing, request):
    scene, lights, options = request
    result = reusing.relight(scene, lights, options=options)
    assert dict(reusing.calls) == result.plan.calls()
    if not options.batch_branches:
        called = sum(reusing.calls[name] for name in ("denoiser", "denoiser_shallow"))
        assert called == result.plan.evaluations
    assert sum(effect.shallow for effect in result.plan.effects) <= result.plan.evaluations


def test_deep_features_are_kept_for_so_many_steps(reusing, scene, shadow, negative):
    light = GuidingShadow(shadow, negative)
    plain = {"options": RelightOptions(denoise=False, steps=6)}
    whole = reusing.relight(scene, light, **plain)
    assert dict(reusing.calls)["denoiser"] == 18
    apart = []
    for reuse, calls in ((2, (9, 9)), (3, (6, 12)), (9, (3, 15))):
        result = reusing.relight(scene, light, **plain, reuse=reuse)
        assert (reusing.calls["denoiser"], reusing.calls["denoiser_shallow"]) == calls
        assert result.evaluations == 18
        effect = next(e for e in result.plan.effects if e.name == "feature reuse")
        assert effect.on
        assert not effect.exact
        assert f"{calls[1]} evaluations are shallow" in effect.reason
        apart.append(float(np.abs(result.image - whole.image).mean()))
    assert 0.0 < apart[0] < apart[1] < apart[2]
    late = reusing.relight(scene, light, **plain, reuse=4, guidance_interval=(0.5, 1.0))
    assert late.plan.passes[0].shallow == (3, 1), "whole where the negative branch begins"


def test_a_step_that_is_whole_is_the_same_to_the_bit(reusing, scene, shadow, negative):
    light = GuidingShadow(shadow, negative)
    reusing.relight(scene, light, denoise=False)
    assert "denoiser_shallow" not in reusing.calls
    one = reusing.relight(scene, light, denoise=False, steps=1, reuse=3)
    np.testing.assert_array_equal(
        one.image, reusing.relight(scene, light, denoise=False, steps=1).image
    )
    assert {e.name: e.on for e in one.plan.effects}["feature reuse"] is False


def test_a_model_without_a_shallow_graph_reuses_nothing(counted, scene, shadow):
    off = counted.relight(scene, shadow, denoise=False)
    asked = counted.relight(scene, shadow, denoise=False, reuse=3)
    np.testing.assert_array_equal(asked.image, off.image)
    effect = next(e for e in asked.plan.effects if e.name == "feature reuse")
    assert (effect.on, effect.exact) == (False, True)
    assert effect.reason == "the model has no graph for it"


def test_branches_together_reuse_the_same_features(reusing, scene, shadow, negative):
    light = GuidingShadow(shadow, negative)
    apart, together = (
        reusing.relight(scene, light, denoise=False, reuse=2, batch_branches=batch)
        for batch in (False, True)
    )
    np.testing.assert_allclose(together.image, apart.image, atol=1e-5)


def test_guidance_in_some_steps_asks_for_the_negative_there_only(counted, scene, shadow, negative):
    light = GuidingShadow(shadow, negative)
    whole = counted.relight(scene, light, denoise=False)
    half = counted.relight(scene, light, denoise=False, guidance_interval=(0.0, 0.5))
    none = counted.relight(scene, light, denoise=False, guidance_interval=(0.3, 0.3))
    unguided = counted.relight(scene, light, denoise=False, gamma=1.0)
    assert [r.evaluations for r in (whole, half, none)] == [12, 10, 8]
    np.testing.assert_array_equal(none.image, unguided.image)
    seen = scene.object_mask > 0.5
    apart = [np.abs(r.image - whole.image)[seen].mean() for r in (half, none)]
    assert 0.0 < apart[0] < apart[1]
    assert half.plan.name == "custom"
    assert not {e.name: e.exact for e in half.plan.effects}["guidance"]


def test_no_shadow_can_have_fewer_steps(counted, scene, shadow):
    result = counted.relight(scene, shadow, denoise=False, plain_steps=1)
    assert counted.calls["denoiser"] == result.evaluations == 9


def test_effects_say_why(relighter, scene, shadow):
    plan = relighter.prepare(scene, shadow, gamma=1.0, beta=0.0, denoise=False).plan
    said = {effect.name: (effect.on, effect.reason) for effect in plan.effects}
    assert said["guidance"] == (False, "γ = 1 adds nothing")
    assert said["shadow blending"] == (False, "β = 0 adds nothing")
    assert said["pass without shadow"][0]
    assert said["soft shadows"] == (False, "the shadows came ready")
    assert said["denoiser"] == (False, "not wanted")
    assert said["window"] == (False, "the whole photograph, 96×64")


def test_a_light_without_size_is_said(relighter):
    pytest.importorskip("embreex", reason="needs the scene extra")
    scene = ball_scene(64)
    lights = [Light(azimuth=40.0, elevation=40.0, radius=radius) for radius in (1.0, 0.0)]
    plans = [relighter.prepare(scene, light, denoise=False).plan for light in lights]
    assert [{e.name: e for e in p.effects}["soft shadows"].on for p in plans] == [True, False]


def test_tight_window_diffuses_less(counted, scene, shadow):
    whole = counted.relight(scene, shadow, denoise=False)
    small = np.zeros_like(shadow)
    small[30:34, 30:40] = 1.0
    tight = counted.relight(scene, small, denoise=False, window="tight")
    assert tight.window.size[0] * tight.window.size[1] < 64 * 96
    assert not tight.window.native
    assert whole.window.native
    outside = np.ones(scene.size, bool)
    box = tight.window
    outside[box.top : box.top + box.height, box.left : box.left + box.width] = False
    assert outside.any()
    untouched = counted.relight(scene, np.zeros_like(shadow), denoise=False).image
    np.testing.assert_array_equal(tight.image[outside], untouched[outside])


def test_lights_with_like_loops_share_calls(counted, scene, shadow, negative):
    lights = [GuidingShadow(shadow, negative), GuidingShadow(negative, shadow)]
    lights = [*lights, GuidingShadow(shadow, shadow), *lights]  # the third has no negative branch
    options = RelightOptions(denoise=False, steps=3, batch_branches=True)
    planned = counted.relighter.prepare(scene, lights, options=options).plan
    assert planned.together == [range(2), range(2, 3), range(3, 5)]
    assert planned.evaluations == 3 + 4 * 6 + 3
    counted.relight(scene, lights, options=options)
    assert counted.calls["denoiser"] == 3 + 3 * 3
    apart = replace(options, batch_branches=False)
    assert len(counted.relighter.prepare(scene, lights, options=apart).plan.together) == 5
