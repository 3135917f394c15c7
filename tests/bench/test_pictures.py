"""Pictures of the methods: SpotLight's are the runtime's own, and nothing is computed twice."""

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.scenes import make_scene, make_shadow

from spotlight_bench.backbone import Backbone
from spotlight_bench.dataset import Direction, TestScene
from spotlight_bench.errors import DataError, MethodError
from spotlight_bench.methods import BUILT_IN, Method
from spotlight_bench.pictures import Studio, foreign_file, pasted_object
from spotlight_bench.sdedit import hidden_everywhere, shadowed_shading, steps_again
from spotlight_runtime import Relighter, RelightOptions, write_image
from spotlight_runtime.diffusion.conditioning import conditioning_array, dilate
from spotlight_runtime.imaging.colour import linear_to_srgb, srgb_to_linear

OPTIONS = RelightOptions(steps=2, denoise=False)


@pytest.fixture(scope="module")
def backbone(backbone_folder):
    """The tiny backbone, counting the calls of its networks."""
    opened = Backbone.load(backbone_folder, threads=1)
    calls = Counter()

    def counted(name):
        def call(**inputs):
            calls[name] += 1
            return opened.networks[name](**inputs)

        return call

    networks = {name: counted(name) for name in opened.networks}
    return Backbone(opened.spec, networks, {"calls": calls})


@pytest.fixture
def calls(backbone):
    backbone.facts["calls"].clear()
    return backbone.facts["calls"]


@pytest.fixture(scope="module")
def test_scene(tmp_path_factory):
    """61×45 pixels: no multiple of what the VAE takes."""
    scene = make_scene(45, 61)
    left, right = make_shadow(scene, "left"), make_shadow(scene, "right")
    directions = (Direction("0000", left, right, None), Direction("0004", right, left, None))
    return TestScene(tmp_path_factory.mktemp("room"), scene, directions)


@pytest.mark.parametrize("fidelity", ["paper", "release"])
@pytest.mark.parametrize(
    "name",
    ["spotlight", "balanced", "draft", "seed-1", "gamma-1", "gamma-7", "beta-0", "negative-none"],
)
def test_spotlight_is_the_runtimes_relight_bit_for_bit(backbone, test_scene, name, fidelity):
    options = replace(OPTIONS, fidelity=fidelity)
    method, direction = BUILT_IN[name], test_scene.directions[0]
    picture = Studio(backbone, test_scene, options).picture(method, direction).image
    relighter = Relighter(backbone.spec, backbone.networks)
    negative = None if method.negative == "none" else direction.opposite
    seed = options.seed if name != "seed-1" else 1
    wanted = replace(options, gamma=method.gamma, beta=method.beta, seed=seed)
    result = relighter.relight(
        test_scene.scene, direction.shadow, negative, wanted, plan=method.plan
    )
    np.testing.assert_array_equal(picture, result.image)


def test_a_photograph_larger_than_the_backbone_is_relit_in_the_runtimes_window(backbone, tmp_path):
    scene = make_scene(96, 128)
    directions = (
        Direction("0000", make_shadow(scene, "left"), make_shadow(scene, "right"), None),
        Direction("0001", 0.0 * make_shadow(scene), make_shadow(scene, "right"), None),
    )
    studio = Studio(backbone, TestScene(tmp_path, scene, directions), OPTIONS)
    relighter = Relighter(backbone.spec, backbone.networks)
    for direction in directions:
        result = relighter.relight(scene, direction.shadow, direction.opposite, OPTIONS)
        assert not result.window.native
        picture = studio.picture(BUILT_IN["spotlight"], direction).image
        np.testing.assert_array_equal(picture, result.image)
        untouched = studio.picture(BUILT_IN["no-control"], direction).image
        outside = dilate(scene.object_mask) == 0.0
        far = cv2.dilate(1.0 - outside.astype(np.float32), np.ones((17, 17))) == 0.0
        np.testing.assert_array_equal(untouched[far], linear_to_srgb(scene.background)[far])


def test_no_control_is_the_runtimes_picture_without_a_shadow(backbone, test_scene):
    scene, direction = test_scene.scene, test_scene.directions[0]
    picture = Studio(backbone, test_scene, OPTIONS).picture(BUILT_IN["no-control"], direction).image
    result = Relighter(backbone.spec, backbone.networks).relight(
        scene, direction.shadow, None, OPTIONS
    )
    outside = dilate(scene.object_mask) == 0.0
    np.testing.assert_array_equal(picture[outside], linear_to_srgb(scene.background)[outside])
    inside = scene.object_mask == 1.0
    # The same colours but for one factor a channel, the colour balance.
    lit, plain = (srgb_to_linear(p[inside]) for p in (picture, result.no_shadow))
    # Where neither end of the range clips them.
    free = (plain > 0.01).all(axis=1) & (lit < 0.99).all(axis=1)
    assert free.sum() > 20
    balance = (lit / np.maximum(plain, 0.01))[free]
    np.testing.assert_allclose(balance, np.broadcast_to(balance[:1], balance.shape), rtol=2e-3)


def test_what_methods_share_is_computed_once(backbone, test_scene, calls):
    studio = Studio(backbone, test_scene, OPTIONS)
    methods = [BUILT_IN[name] for name in ("no-control", "spotlight", "gamma-1", "negative-none")]
    studio.prepare(methods)
    assert calls == {"condition_encoder": 1, "denoiser": 2, "vae_decoder": 1}
    for direction in test_scene.directions:
        before = Counter(calls)
        for method in methods:
            studio.picture(method, direction)
        made = Counter(calls) - before
        # Three times two branches of two steps, but the first step knows no method yet.
        assert made["denoiser"] <= 3 * 4 - 2 - 2
        assert made["vae_decoder"] == 3
    before = Counter(calls)
    again = studio.picture(methods[1], test_scene.directions[1])
    assert Counter(calls) == before
    assert again.evaluations == 4


def test_pasted_and_foreign_pictures_need_no_network(backbone, test_scene, calls):
    studio = Studio(backbone, test_scene, OPTIONS)
    studio.prepare([BUILT_IN["pasted"]])
    studio.picture(BUILT_IN["pasted"], test_scene.directions[0])
    assert not calls


def test_another_scene_forgets_the_last(backbone, test_scene, calls):
    for _ in range(2):
        Studio(backbone, test_scene, OPTIONS).prepare([BUILT_IN["no-control"]])
    assert calls["denoiser"] == 4


def test_sdedit_follows_the_shadow_and_costs_half_as_much_again(backbone, test_scene, calls):
    studio = Studio(backbone, test_scene, OPTIONS)
    method = BUILT_IN["sdedit"]
    studio.prepare([method])
    calls.clear()
    one, other = (studio.picture(method, direction) for direction in test_scene.directions)
    assert calls["denoiser"] == one.evaluations + other.evaluations == 2 * 3
    assert not np.array_equal(one.image, other.image)
    again = Studio(backbone, test_scene, OPTIONS).picture(method, test_scene.directions[0])
    np.testing.assert_array_equal(one.image, again.image)
    assert [steps_again(steps) for steps in (1, 2, 5, 20)] == [1, 1, 2, 10]


def test_sdedit_without_a_shadow_and_without_noise_again_is_no_control(
    backbone, test_scene, monkeypatch
):
    """The loop's two ends meet: nothing of the baseline's plumbing shows where it does nothing."""
    from spotlight_bench import sdedit

    monkeypatch.setattr(sdedit, "_again", lambda backbone, latents, *_: latents)
    scene = test_scene.scene
    none = np.zeros(scene.size, np.float32)
    picture = sdedit.sdedit_picture(backbone, scene, none, OPTIONS)
    studio = Studio(backbone, test_scene, OPTIONS)
    wanted = studio.picture(BUILT_IN["no-control"], test_scene.directions[0]).image
    np.testing.assert_array_equal(picture, wanted)


def test_sdedit_puts_the_shadow_into_the_known_shading(backbone):
    scene = make_scene(64, 64)
    spec, shadow = backbone.spec, 0.5 * np.ones((64, 64), np.float32)
    plain = conditioning_array(spec, scene, np.zeros_like(shadow))[None]
    shaded = shadowed_shading(spec, plain, shadow)
    blind = hidden_everywhere(spec, plain)
    names = [entry.name for entry in spec.maps for _ in range(entry.channels)]
    known = dilate(scene.object_mask) == 0.0
    for channel, name in enumerate(names):
        if name == "shading":
            np.testing.assert_allclose(
                shaded[0, channel][known], 0.5 * plain[0, channel][known], rtol=1e-6, atol=1e-5
            )
            np.testing.assert_array_equal(shaded[0, channel][~known], -1.0)
        else:
            np.testing.assert_array_equal(shaded[0, channel], plain[0, channel])
        if name in ("shading", "mask"):
            np.testing.assert_array_equal(blind[0, channel], -1.0)
        else:
            np.testing.assert_array_equal(blind[0, channel], plain[0, channel])
    assert {"shading", "mask"} < set(names)


def test_pasted_object_is_albedo_under_the_photographs_mean_light():
    scene = make_scene(64, 64)
    grey = np.ones_like(scene.background)
    maps = replace(scene.background_maps, albedo=0.5 * grey)
    flat = replace(scene, background=grey * np.float32([0.25, 0.1, 0.05]), background_maps=maps)
    picture = pasted_object(flat)
    inside = scene.object_mask == 1.0
    light = np.float32([0.5, 0.2, 0.1])
    np.testing.assert_allclose(
        picture[inside], linear_to_srgb(scene.object_maps.albedo * light)[inside], atol=1e-5
    )
    outside = scene.object_mask == 0.0
    np.testing.assert_array_equal(picture[outside], linear_to_srgb(flat.background)[outside])


def test_a_missing_opposite_shadow_is_named(backbone, test_scene):
    alone = replace(test_scene.directions[0], opposite=None)
    studio = Studio(backbone, test_scene, OPTIONS)
    with pytest.raises(DataError, match=r"shadow_negative_0000\.png.*negative-none"):
        studio.picture(BUILT_IN["spotlight"], alone)
    assert studio.picture(BUILT_IN["negative-none"], alone).image.shape == (45, 61, 3)


@pytest.mark.parametrize("name", ["{scene}/0000.png", "{scene}_0000.jpg", "{scene}/0000.exr"])
def test_another_methods_picture_is_read_as_srgb(backbone, test_scene, tmp_path, name):
    method = Method("other", "other", "folder", folder=str(tmp_path))
    assert foreign_file(method, test_scene.name, "0000") is None
    path = tmp_path / name.format(scene=test_scene.name)
    path.parent.mkdir(exist_ok=True)
    linear = np.full((45, 61, 3), 0.25, np.float32)
    write_image(path, linear if path.suffix == ".exr" else linear_to_srgb(linear))
    assert foreign_file(method, test_scene.name, "0000") == path
    picture = Studio(backbone, test_scene, OPTIONS).picture(method, test_scene.directions[0]).image
    np.testing.assert_allclose(picture, linear_to_srgb(linear), atol=3e-3)


def test_another_methods_missing_and_misshapen_pictures_are_named(backbone, test_scene, tmp_path):
    method = Method("other", "other", "folder", folder=str(tmp_path))
    studio = Studio(backbone, test_scene, OPTIONS)
    with pytest.raises(MethodError, match=r"0000\.png, found no such picture"):
        studio.picture(method, test_scene.directions[0])
    write_image(tmp_path / f"{test_scene.name}_0000.png", np.zeros((45, 60, 3), np.float32))
    with pytest.raises(MethodError, match=r"61x45.*\(45, 60, 3\)"):
        studio.picture(method, test_scene.directions[0])
