"""One relight from scene to picture, with a tiny random backbone."""

import json
import sys
import time
from dataclasses import fields, replace

import cv2
import numpy as np
import pytest
from support.onnx_backbone import tiny_spec, write_backbone
from support.scenes import make_scene, make_shadow

from spotlight_runtime import GuidingShadow, Intrinsics, Relighter, RelightOptions, Scene, Window
from spotlight_runtime.diffusion.conditioning import masked_region
from spotlight_runtime.errors import (
    DtypeError,
    InvalidInputError,
    MissingMapError,
    ModelError,
    NonFiniteError,
    NumericalError,
    ShapeError,
)
from spotlight_runtime.imaging.colour import linear_to_srgb, srgb_to_linear
from spotlight_runtime.planning.options import OptionChanges
from spotlight_runtime.relighting.result import peak_memory_bytes

SIZES = [(64, 96), (61, 93), (8, 8), (7, 5), (1, 1), (3, 40)]


def far_from(region, margin=8):
    """Pixels further than the composite's soft border from the region."""
    square = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return cv2.dilate(region.astype(np.uint8), square) == 0


@pytest.mark.parametrize("fidelity", ["paper", "release"])
@pytest.mark.parametrize("size", SIZES)
def test_any_size_is_relit(relighter, options, size, fidelity):
    """Also sizes that are no multiple of what the VAE takes."""
    scene = make_scene(*size)
    shadow, negative = make_shadow(scene, "left"), make_shadow(scene, "right")
    result = relighter.relight(scene, shadow, negative, replace(options, fidelity=fidelity))
    for picture in (result.image, result.prediction, result.no_shadow):
        assert picture.shape == (*size, 3)
        assert picture.dtype == np.float32
        assert np.isfinite(picture).all()
        assert picture.min() >= 0.0
        assert picture.max() <= 1.0


def test_size_with_border_relights_like_its_grown_scene(relighter, options):
    scene = make_scene(61, 93)
    shadow = make_shadow(scene)
    grown = np.pad(shadow, ((0, 3), (0, 3)), mode="edge")
    cropped = relighter.relight(scene, shadow, options=options)
    whole = relighter.relight(scene.padded(8), grown, options=options)
    np.testing.assert_array_equal(cropped.prediction, whole.prediction[:61, :93])


def test_background_out_of_reach_is_kept_bit_for_bit(relighter, options, scene, shadow, negative):
    result = relighter.relight(scene, shadow, negative, options)
    cleared = shadow * (1.0 - scene.object_mask)
    far = far_from(masked_region(cleared, scene.object_mask))
    assert 0.2 < far.mean() < 0.9
    kept = linear_to_srgb(scene.background)
    assert result.image[far].tobytes() == kept[far].tobytes()
    assert not np.array_equal(result.image[~far], kept[~far])


def test_photograph_out_of_reach_is_kept_level_for_level(relighter, options, scene, shadow, rng):
    """An 8-bit photograph read, relit and written is the same 8-bit photograph there."""
    levels = rng.integers(0, 256, (64, 96, 3))
    levels.ravel()[:256] = np.arange(256)
    photograph = replace(
        scene, background=srgb_to_linear(levels.astype(np.float32) / np.float32(255))
    )
    result = relighter.relight(photograph, shadow, options=options)
    far = far_from(masked_region(shadow, scene.object_mask))
    np.testing.assert_array_equal(np.round(result.image * 255)[far], levels[far])


def test_release_keeps_the_background_where_nothing_darkened(relighter, options, scene, shadow):
    result = relighter.relight(scene, shadow, options=replace(options, fidelity="release"))
    kept = linear_to_srgb(scene.background)
    outside = far_from(scene.object_mask > 0, margin=2)
    assert (result.image[outside] <= kept[outside] + 1e-5).all()
    assert (result.image == kept).all(axis=-1)[outside].any()


@pytest.mark.parametrize("solver", ["ddim", "dpmpp_2m", "unipc"])
@pytest.mark.parametrize("steps", [1, 2, 3, 7])
def test_any_solver_at_any_number_of_steps(relighter, options, scene, shadow, solver, steps):
    chosen = replace(options, solver=solver, steps=steps)
    result = relighter.relight(scene, shadow, options=chosen)
    assert result.options.steps == steps
    assert result.evaluations == 3 * steps
    assert np.isfinite(result.image).all()


def test_one_step_in_release_mode(relighter, options, scene, shadow):
    """No blend happens, so no step noise is drawn."""
    chosen = replace(options, fidelity="release", steps=1)
    assert np.isfinite(relighter.relight(scene, shadow, options=chosen).image).all()


@pytest.mark.parametrize("kind", ["none", "all", "no object", "object everywhere"])
def test_extreme_masks(relighter, options, kind):
    scene = make_scene(24, 32)
    shadow = make_shadow(scene)
    if kind in ("none", "all"):
        shadow = np.full_like(shadow, kind == "all")
    else:
        mask = np.full_like(scene.object_mask, kind == "object everywhere")
        albedo = mask[..., None] * scene.background_maps.albedo
        normal = mask[..., None] * scene.background_maps.normal
        maps = Intrinsics(albedo, normal, mask * 3.0)
        scene = replace(scene, object_mask=mask, object_maps=maps, footprint_depth=None)
    result = relighter.relight(scene, shadow, shadow, options)
    assert np.isfinite(result.image).all()
    if kind == "no object":
        cleared = far_from(masked_region(shadow, scene.object_mask))
        np.testing.assert_array_equal(
            result.image[cleared], linear_to_srgb(scene.background)[cleared]
        )
    if kind == "object everywhere":
        np.testing.assert_allclose(result.image, result.prediction, atol=1e-6)


def test_black_background_and_black_albedo(relighter, options):
    scene = make_scene(24, 32)
    black = np.zeros_like(scene.background)
    maps = replace(scene.background_maps, albedo=black)
    dark = replace(scene, background=black, background_maps=maps)
    assert np.isfinite(relighter.relight(dark, make_shadow(scene), options=options).image).all()


def test_layout_in_memory_does_not_matter(relighter, options):
    scene = make_scene(24, 32)
    shadow = make_shadow(scene)

    def turned(array):
        array = np.asfortranarray(array)
        array.setflags(write=False)
        return array

    def turned_maps(maps):
        return Intrinsics(*(turned(getattr(maps, n)) for n in Intrinsics.__dataclass_fields__))

    other = replace(
        scene,
        background=turned(scene.background),
        background_maps=turned_maps(scene.background_maps),
        object_maps=turned_maps(scene.object_maps),
        object_mask=turned(scene.object_mask),
        footprint_depth=turned(scene.footprint_depth),
    )
    wanted = relighter.relight(scene, shadow, options=options).image
    got = relighter.relight(other, turned(shadow), options=options).image
    np.testing.assert_allclose(got, wanted, atol=1e-5)


def test_shadow_under_the_object_is_ignored(relighter, options, scene, shadow):
    under = np.where(scene.object_mask == 1.0, 1.0 - shadow, shadow).astype(np.float32)
    a = relighter.relight(scene, shadow, options=options)
    b = relighter.relight(scene, under, options=options)
    assert a.image.tobytes() == b.image.tobytes()


def test_no_negative_is_a_negative_without_shadow(relighter, options, scene, shadow):
    a = relighter.relight(scene, shadow, None, options)
    b = relighter.relight(scene, shadow, np.zeros_like(shadow), options)
    assert a.image.tobytes() == b.image.tobytes()


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("gamma", (1.0, 7.0)),
        ("beta", (0.0, 0.5)),
        ("seed", (1, 2)),
        ("steps", (2, 5)),
        ("solver", ("ddim", "unipc")),
        ("fidelity", ("paper", "release")),
        ("guidance_rescale", (0.0, 1.0)),
        ("shadow_opacity", (0.0, 1.0)),
    ],
)
def test_every_option_counts(relighter, options, scene, shadow, negative, name, values):
    pictures = []
    for value in values:
        chosen = replace(options, **({"beta": 0.4} | {name: value}))
        pictures.append(relighter.relight(scene, shadow, negative, chosen).prediction)
    assert np.abs(pictures[0] - pictures[1]).max() > 1e-4


@pytest.mark.parametrize("which", ["shadow", "negative"])
@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda s: s.astype(np.float64), DtypeError),
        (lambda s: (s * 255).astype(np.uint8), DtypeError),
        (lambda s: s.tolist(), DtypeError),
        (lambda s: s[:-1], ShapeError),
        (lambda s: s[..., None], ShapeError),
        (lambda s: s[:0], ShapeError),
        (lambda s: s * np.float32(np.nan), NonFiniteError),
        (lambda s: s * np.float32(255), InvalidInputError),
        (lambda s: s - np.float32(0.5), InvalidInputError),
    ],
    ids=["float64", "uint8", "list", "rows", "channels", "empty", "nan", "255", "negative"],
)
def test_bad_shadow_is_named(relighter, options, scene, shadow, which, spoil, error):
    with np.errstate(invalid="ignore"):
        bad = spoil(shadow)
    pair = (bad, shadow) if which == "shadow" else (shadow, bad)
    with pytest.raises(error, match=f"^{which}: "):
        relighter.relight(scene, *pair, options)


def test_scene_without_a_map_of_the_backbone(relighter, options, scene, shadow):
    poorer = replace(scene, object_maps=replace(scene.object_maps, normal=None))
    with pytest.raises(MissingMapError, match="no normal map of its object"):
        relighter.relight(poorer, shadow, options=options)


def test_more_steps_than_the_backbone_has_is_said_before_any_work(options, scene, shadow):
    def refuse(**arrays):
        raise AssertionError("a network was run")

    names = ("vae_encoder", "condition_encoder", "denoiser", "vae_decoder")
    idle = Relighter(tiny_spec(), dict.fromkeys(names, refuse))
    with pytest.raises(InvalidInputError, match="steps: expected a whole number from 1 to 1000"):
        idle.relight(scene, shadow, options=replace(options, fidelity="release", steps=10**12))


@pytest.mark.parametrize("gain", [np.inf, np.nan, 1e38])
def test_backbone_that_overflows_names_the_step(tmp_path, options, scene, shadow, gain):
    broken = Relighter.load(write_backbone(tmp_path / "broken", gain=gain), threads=1)
    with pytest.raises(
        NumericalError, match=r"step \d \(timestep \d+\): the denoiser's prediction"
    ):
        broken.relight(scene, shadow, options=options)


@pytest.mark.parametrize("fidelity", ["paper", "release"])
@pytest.mark.parametrize("gain", [3e37, 1e37, 1e30])
def test_huge_numbers_are_one_error_or_a_finite_picture(
    tmp_path, options, scene, shadow, gain, fidelity
):
    """Never a warning, never a NaN."""
    broken = Relighter.load(write_backbone(tmp_path / "broken", gain=gain), threads=1)
    try:
        result = broken.relight(scene, shadow, options=replace(options, fidelity=fidelity))
    except NumericalError:
        assert gain > 1e30
    else:
        assert np.isfinite(result.image).all()


def test_network_that_refuses_its_inputs_is_a_model_error(relighter, scene, shadow, options):
    inputs = relighter.loop_inputs(scene, shadow, None, options)
    wrong = replace(inputs, conditioning=inputs.conditioning[:, :5])
    with pytest.raises(ModelError, match=r"condition_encoder\.onnx: cannot be run"):
        list(relighter.trajectory(wrong, options))


def test_plain_functions_are_networks(options):
    """Sessions are injected: a relighter of four lambdas."""
    spec = tiny_spec(steps=2)
    grey = {
        "vae_encoder": lambda image: {
            "latent_mean": np.zeros((1, 4, 3, 4), np.float32),
            "latent_std": np.ones((1, 4, 3, 4), np.float32),
        },
        "condition_encoder": lambda conditioning: {"condition": conditioning[..., ::8, ::8]},
        "denoiser": lambda latents, timestep, condition: {"prediction": latents},
        "vae_decoder": lambda latents: {"image": np.zeros((1, 3, 24, 32), np.float32)},
    }
    scene = make_scene(24, 32)
    result = Relighter(spec, grey).relight(scene, make_shadow(scene), options=options)
    np.testing.assert_allclose(result.prediction, result.no_shadow)
    assert result.report()["model"] == {}


@pytest.mark.parametrize("fidelity", ["paper", "release"])
def test_where_the_background_may_darken(options, fidelity):
    """Predicted darker everywhere: the paper's mode darkens the region, the release all."""
    scene = make_scene(64, 96)
    shadow = np.zeros(scene.size, np.float32)
    shadow[50:62, 4:16] = 1.0
    decoded = iter([-0.2, 0.2])
    zeros = np.zeros((1, 4, 8, 12), np.float32)
    grey = {
        "vae_encoder": lambda image: {"latent_mean": zeros, "latent_std": zeros},
        "condition_encoder": lambda conditioning: {"condition": conditioning[..., ::8, ::8]},
        "denoiser": lambda latents, timestep, condition: {"prediction": latents},
        "vae_decoder": lambda latents: {"image": np.full((1, 3, 64, 96), next(decoded), "f4")},
    }
    relighter = Relighter(tiny_spec(steps=1), grey)
    result = relighter.relight(scene, shadow, options=replace(options, fidelity=fidelity))
    kept = linear_to_srgb(scene.background)
    darkened = (result.image < kept - 1e-4).all(axis=-1)
    assert darkened[52:60, 6:14].all()
    far = far_from((shadow > 0) | (scene.object_mask > 0))
    assert darkened[far].all() if fidelity == "release" else not darkened[far].any()


def test_progress_is_two_passes_and_closing_cancels(relighter, options, scene, shadow):
    steps = [(p.stage, p.step.index, p.steps) for p in relighter.run(scene, shadow, None, options)]
    wanted = [("relight", i, 4) for i in range(4)] + [("no shadow", i, 4) for i in range(4)]
    assert steps == wanted
    run = relighter.run(scene, shadow, None, options)
    next(run)
    run.close()
    assert list(run) == []


def test_closing_stops_asking_the_network(relighter, options, scene, shadow):
    asked = []
    counted = dict(relighter._networks)
    denoiser = counted["denoiser"]

    def counting(**arrays):
        asked.append(1)
        return denoiser(**arrays)

    run = Relighter(relighter.spec, counted | {"denoiser": counting}).run(
        scene, shadow, None, options
    )
    next(run)
    next(run)
    run.close()
    assert len(asked) == 4  # two steps of two branches


def test_trajectory_on_loop_inputs_is_the_relight(relighter, options, scene, shadow, negative):
    for fidelity in ("paper", "release"):
        chosen = replace(options, fidelity=fidelity)
        inputs = relighter.loop_inputs(scene, shadow, negative, chosen)
        replayed = [step.latents for step in relighter.trajectory(inputs, chosen)]
        run = relighter.run(scene, shadow, negative, chosen)
        seen = [p.step.latents for p in run if p.stage == "relight"]
        assert [z.tobytes() for z in replayed] == [z.tobytes() for z in seen]


def test_loop_inputs_have_the_documented_shapes(relighter, options, shadow, scene, negative):
    inputs = relighter.loop_inputs(scene, shadow, negative, replace(options, fidelity="release"))
    assert inputs.conditioning.shape == (2, 11, 64, 96)
    assert inputs.composite_latents.shape == (2, 4, 8, 12)
    assert inputs.shadow_mask.shape == (2, 1, 8, 12)
    assert inputs.guidance_mask.shape == (1, 1, 8, 12)
    assert inputs.initial_noise.shape == (1, 4, 8, 12)
    assert inputs.step_noise.shape == (3, 4, 8, 12)
    for field in fields(inputs):
        value = getattr(inputs, field.name)
        assert field.name == "lights" or value.dtype == np.float32, field.name
    assert relighter.loop_inputs(scene, shadow).conditioning.shape == (2, 11, 64, 96)


def test_paper_and_release_draw_what_they_say(relighter, options, scene, shadow, negative):
    paper = relighter.loop_inputs(scene, shadow, negative, options)
    release = relighter.loop_inputs(scene, shadow, negative, replace(options, fidelity="release"))
    np.testing.assert_array_equal(paper.initial_noise, release.initial_noise)
    np.testing.assert_array_equal(paper.step_noise, paper.initial_noise)
    assert not np.array_equal(release.step_noise[0], release.step_noise[1])
    assert not np.array_equal(paper.composite_latents, release.composite_latents)


@pytest.mark.parametrize("fidelity", ["paper", "release"])
def test_a_backbone_may_start_near_one_place(relighter, options, scene, shadow, negative, fidelity):
    options = replace(options, fidelity=fidelity)
    mean = (0.5, -1.0, 0.0, 2.0)
    near = replace(relighter.spec.latent, start_mean=mean, start_deviation=0.25)
    relighters = (relighter, Relighter(replace(relighter.spec, latent=near), relighter._networks))
    unit, own = (each.loop_inputs(scene, shadow, negative, options) for each in relighters)
    shift = np.float32(mean)[:, None, None]
    np.testing.assert_array_equal(own.initial_noise, 0.25 * unit.initial_noise + shift)
    np.testing.assert_array_equal(own.step_noise, 0.25 * unit.step_noise)
    assert own.initial_noise.dtype == own.step_noise.dtype == np.float32


def test_released_posterior_is_sampled_for_each_branch(relighter, options, scene, shadow):
    """Equal shadows encode equally; what differs between the branches is their sample."""
    inputs = relighter.loop_inputs(scene, shadow, shadow, replace(options, fidelity="release"))
    assert not np.array_equal(*inputs.composite_latents)
    inputs = relighter.loop_inputs(scene, shadow, shadow, options)
    np.testing.assert_array_equal(*inputs.composite_latents)


def test_both_passes_start_from_the_same_noise(relighter, options, scene, shadow):
    started = []
    denoiser = relighter._networks["denoiser"]

    def noting(latents, timestep, condition):
        if timestep[0] == 999:
            started.append(latents)
        return denoiser(latents=latents, timestep=timestep, condition=condition)

    networks = dict(relighter._networks) | {"denoiser": noting}
    Relighter(relighter.spec, networks).relight(scene, shadow, options=options)
    positive, negative, plain = started
    np.testing.assert_array_equal(positive, negative)
    np.testing.assert_array_equal(positive, plain)


def test_report_is_json_with_everything_but_the_pixels(relighter, scene, shadow):
    options = RelightOptions(denoise=False, steps=2, seed=np.int64(7))
    report = json.loads(json.dumps(relighter.relight(scene, shadow, options=options).report()))
    assert report["options"]["seed"] == 7
    assert report["size"] == {"width": 96, "height": 64}
    assert report["evaluations"] == 6
    assert report["denoised"] == "off: not wanted"
    assert report["model"]["name"] == "tiny"
    assert report["peak_memory_bytes"] > 1e6
    stages = {"prepare", "encode", "condition", "relight", "no shadow", "decode", "composite"}
    assert set(report["seconds"]) == stages
    assert all(seconds >= 0.0 for seconds in report["seconds"].values())


def test_platform_without_resource_usage_reports_no_memory(monkeypatch, tmp_path):
    nothing = tmp_path / "status"
    assert peak_memory_bytes() > 1e6
    assert peak_memory_bytes(nothing) > 1e6
    nothing.write_text("Name: python\n")
    monkeypatch.setitem(sys.modules, "resource", None)
    assert peak_memory_bytes(nothing) is None


def test_clean_backbone_is_not_denoised(options, scene, shadow, tmp_path):
    spec = replace(tiny_spec(steps=1), noisy_renders=False)
    clean = Relighter.load(write_backbone(tmp_path / "clean", spec), threads=1)
    result = clean.relight(scene, shadow, options=replace(options, denoise=None))
    assert result.denoised == "off: the backbone was trained on clean renders"


def test_caller_may_take_its_time_between_steps(relighter, options, scene, shadow):
    """The time the caller spends is not counted as the network's."""
    run = relighter.run(scene, shadow, None, replace(options, steps=2))
    while True:
        try:
            next(run)
        except StopIteration as stop:
            timings = stop.value.timings
            break
        time.sleep(0.3)
    assert timings["relight"] + timings["no shadow"] < 4 * 0.3


def test_options_by_name(relighter, options, scene, shadow):
    named = relighter.relight(scene, shadow, denoise=False, steps=2, gamma=5.0)
    given = relighter.relight(scene, shadow, options=replace(options, steps=2, gamma=5.0))
    assert named.image.tobytes() == given.image.tobytes()
    assert named.options == given.options
    both = relighter.relight(scene, shadow, options=replace(options, steps=2), gamma=5.0)
    assert both.options == given.options


def test_every_option_has_its_name():
    assert list(OptionChanges.__annotations__) == list(RelightOptions.__dataclass_fields__)
    with pytest.raises(TypeError, match="gama"):
        Relighter(tiny_spec(), {}).prepare(make_scene(), make_shadow(make_scene()), gama=3.0)


def test_preview_of_the_last_step_is_the_prediction(relighter, options, scene, shadow):
    run = relighter.run(scene, shadow, None, replace(options, solver="dpmpp_2m"))
    previews = {}
    while True:
        try:
            progress = next(run)
        except StopIteration as stop:
            result = stop.value
            break
        preview = relighter.preview_of(progress)
        assert preview.shape == (64, 96, 3)
        assert 0.0 <= preview.min() <= preview.max() <= 1.0
        previews[progress.stage] = preview
    # This solver's last step lands on what it predicts.
    np.testing.assert_allclose(previews["relight"], result.prediction, atol=1e-3)
    np.testing.assert_allclose(previews["no shadow"], result.no_shadow, atol=1e-3)


def test_progress_says_which_light_and_where(relighter, options, shadow, scene):
    lights = [shadow, shadow]
    seen = [
        (p.stage, p.light, p.lights, p.window)
        for p in relighter.run(scene, lights, options=replace(options, steps=1))
    ]
    window = Window.whole((64, 96))
    assert seen == [
        ("relight", 0, 2, window),
        ("relight", 1, 2, window),
        ("no shadow", 0, 2, window),
    ]


def test_results_come_as_they_are_done(relighter, options, shadow, scene):
    made = list(relighter.run_each(scene, [shadow, shadow], options=replace(options, steps=1)))
    kinds = [type(each).__name__ for each in made]
    assert kinds == ["Progress", "Progress", "RelightResult", "Progress", "RelightResult"]
    assert made[2].image.tobytes() == made[4].image.tobytes()
    assert made[2].guides[0].positive is shadow


@pytest.mark.parametrize("batch", [False, True])
def test_each_picture_has_its_own_time(relighter, options, shadow, negative, scene, batch):
    """What lights share counts for the first, and what two go through together for half each."""
    lights = [GuidingShadow(shadow, negative), GuidingShadow(negative, shadow)]
    chosen = replace(options, steps=2, batch_branches=batch)
    started = time.perf_counter()
    first, second = relighter.relight_each(scene, lights, options=chosen)
    took = time.perf_counter() - started
    assert {"prepare", "no shadow"} <= set(first.timings)
    assert not {"prepare", "no shadow"} & set(second.timings)
    assert set(second.timings) == {"encode", "condition", "relight", "decode", "composite"}
    assert sum(first.timings.values()) + sum(second.timings.values()) <= took
    assert (first.timings["relight"] == second.timings["relight"]) == batch


def test_a_backbone_for_the_picture_around_an_object_is_refused(tmp_path):
    """Its shading is the relit object's, which the first relight is yet to make."""
    folder = write_backbone(tmp_path / "inverted", tiny_spec("zerocomp-inverted"))
    with pytest.raises(ModelError, match=r"^zerocomp-inverted: .*To relight an object use another"):
        Relighter.load(folder)


def test_scene_and_options_are_values():
    assert Scene.__dataclass_params__.frozen
    assert RelightOptions.__dataclass_params__.frozen
