"""A photograph larger than the backbone: diffused in a window, put back sharp and exact."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.onnx_backbone import tiny_spec, write_backbone
from support.scenes import make_scene, make_shadow

from spotlight_runtime import GuidingShadow, Intrinsics, Relighter, RelightOptions
from spotlight_runtime.imaging.colour import linear_to_gamma22, linear_to_srgb
from spotlight_runtime.relighting.canvas import Canvas
from spotlight_runtime.relighting.finishing import layer
from spotlight_runtime.relighting.layers import SOFT_BORDER, window_layer
from spotlight_runtime.relighting.mixing import Mix
from spotlight_runtime.relighting.preparation import prepare_window
from spotlight_runtime.relighting.putback import put_back
from spotlight_runtime.relighting.window import Window, look, shrink

SPEC = replace(tiny_spec(), image_encoding="gamma22")
DARKNESS = 0.6


@pytest.fixture(scope="module")
def large():
    return make_scene(360, 480)


@pytest.fixture(scope="module")
def shadows(large):
    return make_shadow(large, "left"), make_shadow(large, "right")


def psnr(got, wanted, where):
    return -10 * np.log10(np.mean((got - wanted)[where] ** 2))


def touched(scene, shadow, margin=SOFT_BORDER + 1):
    """Object and shadow, and what the soft border may reach beyond them."""
    square = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    covered = (shadow * (1 - scene.object_mask) > 0.1) | (scene.object_mask > 0)
    return cv2.dilate(covered.astype(np.uint8), square) > 0


@pytest.mark.parametrize("size", [(360, 480), (333, 471), (97, 641), (1200, 30)])
@pytest.mark.parametrize("fidelity", ["paper", "release"])
def test_the_picture_has_the_photographs_size(relighter, options, size, fidelity):
    scene = make_scene(*size)
    chosen = replace(options, fidelity=fidelity, steps=2)
    result = relighter.relight(scene, make_shadow(scene), make_shadow(scene, "right"), chosen)
    assert result.image.shape == (*size, 3)
    assert result.image.dtype == np.float32
    assert np.isfinite(result.image).all()
    assert not result.window.native
    assert result.prediction.shape == result.no_shadow.shape == (*result.window.size, 3)
    assert result.report()["window"]["size"] == result.window.size


def test_what_neither_object_nor_shadow_covers_is_kept_bit_for_bit(
    relighter, options, large, shadows
):
    result = relighter.relight(large, *shadows, options)
    far = ~touched(large, shadows[0])
    assert 0.3 < far.mean() < 0.9
    kept = linear_to_srgb(large.background)
    assert result.image[far].tobytes() == kept[far].tobytes()
    assert (result.image != kept).any(axis=-1)[large.object_mask == 1].mean() > 0.9


def test_release_reaches_the_whole_window_and_fades_where_it_ends(relighter, options, large):
    """An object in a corner: the window ends inside the photograph on two sides only."""
    mask = np.roll(large.object_mask, (-80, -140), axis=(0, 1))
    roll = {
        name: np.roll(getattr(large.object_maps, name), (-80, -140), axis=(0, 1))
        for name in Intrinsics.__dataclass_fields__
    }
    scene = replace(large, object_mask=mask, object_maps=Intrinsics(**roll), footprint_depth=None)
    shadow = np.zeros_like(mask)
    chosen = replace(options, fidelity="release", steps=1)
    result = relighter.relight(scene, shadow, options=chosen)
    window = result.window
    assert window.height < 360
    kept = linear_to_srgb(scene.background)
    outside = np.ones(scene.size, bool)
    window.crop(outside)[:] = False
    np.testing.assert_array_equal(result.image[outside], kept[outside])
    inside = window.crop(result.image - kept)[:-1, :-1]
    assert np.abs(inside[-1]).max() < 0.1
    assert np.abs(inside[: window.height // 2, : window.width // 2]).max() > 0.1


def test_frame_is_diffused_whole_on_demand(relighter, options, shadows):
    scene = make_scene(104, 136)
    shadow = make_shadow(scene)
    whole = relighter.relight(scene, shadow, options=options, window="frame", steps=1)
    assert whole.window == Window.whole((104, 136))
    assert whole.prediction.shape == (104, 136, 3)
    window = relighter.relight(scene, shadow, options=options, steps=1)
    assert window.prediction.shape != whole.prediction.shape


def shaded(scene):
    """The scene under a light from the upper left: a picture in linear light and its parts."""
    towards = np.float32([-0.5, 0.7, 0.5])
    lambert = 0.3 + 0.7 * np.maximum(scene.object_maps.normal @ towards, 0.0)[..., None]
    return scene.object_maps.albedo * lambert


@pytest.fixture(scope="module")
def textured(large):
    """The large scene with fine texture on the object."""
    rows, columns = np.mgrid[:360, :480]
    stripes = 0.5 + 0.4 * np.sign(np.sin(columns / 2.0) * np.sin(rows / 3.0))
    albedo = large.object_mask[..., None] * stripes[..., None] * np.float32([0.9, 0.6, 0.5])
    maps = replace(large.object_maps, albedo=albedo.astype(np.float32))
    return replace(large, object_maps=maps)


def put_back_perfectly(scene, shadow, scale, gamma=1.0, distort=lambda picture: picture, spec=SPEC):
    """A renderer that is right, at the model's scale: what comes back, and what should."""
    cleared = shadow * (1 - scene.object_mask)
    left = (1 - DARKNESS * shadow)[..., None] * (1 - scene.object_mask[..., None])
    light, dark = shaded(scene), scene.background * left
    truth = light + dark
    height, width = scene.size
    window = Window(0, 0, height, width, (height // scale, width // scale), scene.size)
    view = look(scene, window)
    visible = np.maximum(1 - view.object_mask, 1e-6)
    small_shadow = shrink(cleared, window.size) / visible * (1 - view.object_mask)
    plain = shrink(light + scene.background * (1 - scene.object_mask[..., None]), window.size)
    # A decoder leaves pictures a little softer than what was encoded.
    encoded = [
        cv2.GaussianBlur(linear_to_gamma22(p), (0, 0), 0.5)
        for p in (shrink(truth, window.size), plain)
    ]
    encoded[0] = distort(encoded[0])
    made = window_layer(
        spec, Canvas.of(scene), window, shadow, view, small_shadow, *encoded, "paper", gamma
    )
    image = put_back(Canvas.of(scene), window, [made], Mix.of([GuidingShadow(shadow)]))
    enlarged = cv2.resize(
        shrink(truth, window.size), (width, height), interpolation=cv2.INTER_CUBIC
    )
    return image, linear_to_srgb(truth), linear_to_srgb(enlarged)


@pytest.mark.parametrize("scale", [2, 4, 8])
def test_a_right_prediction_comes_back_sharp(textured, shadows, scale):
    """Far closer to the truth than the prediction enlarged: on the object and at its edge."""
    image, truth, enlarged = put_back_perfectly(textured, shadows[0], scale)
    mask = textured.object_mask
    edge = (mask > 0) & (mask < 1)
    for where, least, gain in ((mask == 1, 32.0, 10.0), (edge, 26.0, 3.0)):
        assert psnr(image, truth, where) > least
        assert psnr(image, truth, where) > psnr(enlarged, truth, where) + gain


def test_light_is_freed_of_what_a_small_decoder_adds(textured, shadows, rng):
    """Its latents are eight pixels wide, and each errs on its own."""

    def blotched(picture):
        rows, columns = (-(-side // 8) for side in picture.shape[:2])
        errors = rng.uniform(0.8, 1.2, (rows, columns)).astype(np.float32)
        return picture * errors.repeat(8, 0).repeat(8, 1)[: len(picture), : picture.shape[1], None]

    lit = textured.object_mask == 1
    dark = (shadows[0] > 0.3) & (textured.object_mask == 0)
    found = []
    for reach in (0.0, 8.0):
        spec = replace(SPEC, light_reach=reach)
        image, truth, _ = put_back_perfectly(textured, shadows[0], 2, distort=blotched, spec=spec)
        found.append([psnr(image, truth, where) for where in (lit, dark)])
    before, after = found
    assert after[0] > before[0] + 3.0
    assert after[1] > before[1] + 3.0


@pytest.mark.parametrize("scale", [2, 4, 8])
def test_a_predicted_shadow_follows_the_guiding_shadow(large, shadows, scale):
    image, truth, _ = put_back_perfectly(large, shadows[0], scale)
    inside = (shadows[0] > 0.3) & (large.object_mask == 0)
    assert psnr(image, truth, inside) > 36.0


def test_latents_that_are_guided_too_leave_no_dark_squares(large, shadows):
    """Guidance makes the shadow in the object's own latents too dark, background and all."""
    scale, (rows, columns) = 4, (90 // 8, 120 // 8)
    mask = shrink(large.object_mask, (90, 120))[: rows * 8, : columns * 8]
    share = mask.reshape(rows, 8, columns, 8).mean(axis=(1, 3))

    def blackened(picture):
        found = picture.copy()
        shared = (share > 0.05).repeat(8, axis=0).repeat(8, axis=1) & (mask < 0.5)
        found[: rows * 8, : columns * 8][shared] *= 0.1
        return found

    beside = (shadows[0] > 0.3) & (large.object_mask == 0)
    beside &= cv2.dilate(large.object_mask, np.ones((25, 25))) > 0
    believed, doubted = (
        psnr(*put_back_perfectly(large, shadows[0], scale, gamma, blackened)[:2], beside)
        for gamma in (1.0, 3.0)
    )
    assert believed < 22.0
    assert doubted > 30.0


def test_hard_shadow_edges_stay_hard(large):
    shadow = np.zeros(large.size, np.float32)
    shadow[250:320, 60:200] = 1.0
    image, truth, _ = put_back_perfectly(large, shadow, 8)
    core = np.zeros(large.size, bool)
    core[262:308, 72:170] = True
    assert psnr(image, truth, core & (large.object_mask == 0)) > 34.0
    just_outside = np.s_[240:242, 70:120]
    np.testing.assert_array_equal(
        image[just_outside], linear_to_srgb(large.background)[just_outside]
    )


def test_a_shadow_cleared_under_the_object_leaves_no_bright_rim(large):
    """On the object's antialiased edge a cast shadow is attenuated; the ground there is not."""
    everywhere = np.ones(large.size, np.float32)
    cleared = everywhere * (1 - large.object_mask)
    image, truth, _ = put_back_perfectly(large, everywhere, 4)
    edge = (large.object_mask > 0) & (large.object_mask < 1)
    again, _, _ = put_back_perfectly(large, cleared, 4)
    assert np.abs(again - image)[edge].max() < 0.1
    assert psnr(again, truth, edge) > 24.0


def test_rows_of_a_layer_join(textured, shadows):
    guides = [GuidingShadow(shadows[0])]
    prepared = prepare_window(SPEC, textured, guides)
    rng = np.random.default_rng(0)
    pictures = [rng.random((*prepared.view.size, 3), np.float32) for _ in range(2)]
    made = layer(SPEC, prepared, 0, *pictures, RelightOptions())
    whole, untouched = made.rows(0, prepared.window.height)
    for top in range(0, prepared.window.height, 37):
        part, kept = made.rows(top, min(top + 37, prepared.window.height))
        np.testing.assert_allclose(part, whole[top : top + 37], atol=1e-6)
        np.testing.assert_array_equal(kept, untouched[top : top + 37])


def test_an_object_without_normals_is_put_back_too(relighter, options, large, shadows):
    spec = replace(relighter.spec, maps=tuple(m for m in relighter.spec.maps if m.name != "normal"))
    bare = replace(large, object_maps=replace(large.object_maps, normal=None))
    prepared = prepare_window(spec, bare, [GuidingShadow(shadows[0])])
    picture = np.full((*prepared.view.size, 3), 0.5, np.float32)
    made = layer(spec, prepared, 0, picture, picture, RelightOptions())
    image = put_back(prepared.canvas, prepared.window, [made], prepared.mix)
    assert np.isfinite(image).all()


@pytest.mark.parametrize(("size", "scale"), [((200, 300), 2), ((61, 93), 1), ((1200, 30), 1.3)])
def test_what_was_grown_for_the_vae_is_cut_off_again(size, scale):
    """A right prediction of a view with a grown border comes back in its place."""
    scene = make_scene(*size)
    shadow = make_shadow(scene)
    prepared = prepare_window(SPEC, scene, [GuidingShadow(shadow)])
    view, (cleared, _) = prepared.view, prepared.shadows[0]
    assert view.size[0] % 8 == view.size[1] % 8 == 0
    assert prepared.window.scale == pytest.approx(scale, rel=0.2)
    front = view.object_maps.albedo * np.float32(0.5)
    behind = view.background * (1 - view.object_mask[..., None])
    dark = front + behind * (1 - DARKNESS * cleared)[..., None]
    pictures = [linear_to_gamma22(p) for p in (dark, front + behind)]
    options = RelightOptions(detail="maps")
    made = layer(SPEC, prepared, 0, *pictures, options)
    image = put_back(prepared.canvas, prepared.window, [made], prepared.mix)
    left = (1 - DARKNESS * shadow)[..., None] * (1 - scene.object_mask[..., None])
    truth = linear_to_srgb(scene.object_maps.albedo * 0.5 + scene.background * left)
    assert psnr(image, truth, scene.object_mask == 1) > 33.0
    inside = (shadow > 0.3) & (scene.object_mask == 0)
    assert psnr(image, truth, inside) > 28.0


def test_detail_of_a_whole_photograph_is_to_choose(relighter, options):
    scene = make_scene(64, 96)
    shadow = make_shadow(scene)
    auto, renderer, maps = (
        relighter.relight(scene, shadow, options=options, detail=detail)
        for detail in ("auto", "renderer", "maps")
    )
    assert auto.image.tobytes() == renderer.image.tobytes()
    assert maps.prediction.tobytes() == renderer.prediction.tobytes()
    assert np.abs(maps.image - renderer.image).max() > 0.05
    far = ~touched(scene, shadow)
    np.testing.assert_array_equal(maps.image[far], linear_to_srgb(scene.background)[far])


def test_pixels_that_are_not_believed_are_not_shown_unasked(relighter, options):
    scene = make_scene(64, 96)
    shadow = make_shadow(scene)
    smooth = Relighter(replace(relighter.spec, light_reach=8.0), relighter._networks)
    auto, renderer, maps = (
        smooth.relight(scene, shadow, options=options, detail=detail).image
        for detail in ("auto", "renderer", "maps")
    )
    assert auto.tobytes() == maps.tobytes() != renderer.tobytes()
    believed = relighter.relight(scene, shadow, options=options)
    assert renderer.tobytes() == believed.image.tobytes()


def test_extreme_objects(relighter, options):
    """None, everywhere, and thinner than a pixel of the model."""
    scene = make_scene(200, 300)
    shadow = make_shadow(scene)
    thin = np.zeros(scene.size, np.float32)
    thin[100, 150] = 1.0
    for mask in (np.zeros_like(thin), np.ones_like(thin), thin):
        cover = mask[..., None]
        maps = Intrinsics(
            albedo=cover * scene.background_maps.albedo,
            normal=cover * scene.background_maps.normal,
            depth=mask * np.float32(3.0),
        )
        changed = replace(scene, object_mask=mask, object_maps=maps, footprint_depth=None)
        for drawn in (shadow, np.zeros_like(shadow), np.ones_like(shadow)):
            result = relighter.relight(changed, drawn, options=options, steps=1)
            assert np.isfinite(result.image).all()
            assert result.image.shape == (200, 300, 3)


def test_shadow_under_the_object_is_ignored(relighter, options, large, shadows):
    under = np.where(large.object_mask == 1.0, 1.0 - shadows[0], shadows[0]).astype(np.float32)
    a = relighter.relight(large, shadows[0], options=options, steps=1)
    b = relighter.relight(large, under, options=options, steps=1)
    covered = large.object_mask == 1.0
    beside = cv2.dilate(covered.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
    np.testing.assert_array_equal(a.prediction, b.prediction)
    np.testing.assert_allclose(a.image[beside | covered], b.image[beside | covered], atol=1e-5)


def test_materials_nobody_described_are_matt_and_no_metal(large, shadows):
    bare = replace(
        large,
        background_maps=replace(large.background_maps, roughness=None, metallic=None),
        object_maps=replace(large.object_maps, metallic=None),
    )
    view = prepare_window(SPEC, bare, [GuidingShadow(shadows[0])]).view
    assert np.unique(view.background_maps.roughness) == np.float32(0.7)
    assert not view.background_maps.metallic.any()
    assert not view.object_maps.metallic.any()
    told = prepare_window(SPEC, large, [GuidingShadow(shadows[0])]).view
    np.testing.assert_array_equal(view.object_maps.roughness, told.object_maps.roughness)


def test_what_is_prepared_runs_again_and_again(relighter, options, large, shadows):
    task = relighter.prepare(large, *shadows, options)
    wanted = relighter.relight(large, *shadows, options)

    def finished():
        run = relighter.start(task)
        while True:
            try:
                next(run)
            except StopIteration as stop:
                return stop.value

    first, second = finished(), finished()
    assert first.image.tobytes() == second.image.tobytes() == wanted.image.tobytes()
    assert second.timings["relight"] < 2 * sum(first.timings.values())
    assert set(task.stopwatch.seconds) == {"prepare"}


RELIGHT = """
import json, sys
from pathlib import Path
from spotlight_runtime.cli import main
sys.argv = ["spotlight", "relight", *sys.argv[1:]]
main()
"""


@pytest.mark.full
def test_twelve_megapixels_fit_in_one_and_a_half_gigabytes(tmp_path, capsys):
    """A 4000×3000 scene from its folder to a PNG, by the command people type."""
    import json

    from spotlight_runtime import Scene, read_image, write_image
    from spotlight_runtime.networks.models import find_models

    here = [m for m in find_models() if m.manifest.backbone.name == "mini"]
    model = here[0].path if here else write_backbone(tmp_path / "tiny", tiny_spec("mini"))
    small = make_scene(750, 1000)

    def grown(array):
        return None if array is None else np.repeat(np.repeat(array, 4, axis=0), 4, axis=1)

    def grown_maps(maps):
        return Intrinsics(*(grown(getattr(maps, n)) for n in Intrinsics.__dataclass_fields__))

    scene = Scene(
        background=grown(small.background),
        background_maps=grown_maps(small.background_maps),
        object_maps=grown_maps(small.object_maps),
        object_mask=grown(small.object_mask),
        footprint_depth=grown(small.footprint_depth),
        field_of_view=50.0,
    )
    scene.save(tmp_path / "scene")
    shadow = grown(make_shadow(small))
    write_image(tmp_path / "left.png", shadow)
    write_image(tmp_path / "right.png", grown(make_shadow(small, "right")))
    command = [sys.executable, "-c", RELIGHT, "scene", "--shadow", "left.png"]
    command += ["--negative", "right.png", "--model", str(Path(model).resolve()), "-o", "out.png"]
    command += ["--report", "report.json"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    report = json.loads((tmp_path / "report.json").read_text())
    with capsys.disabled():
        peak, seconds = report["peak_memory_bytes"], report["seconds"]
        print(f"\n  {Path(model).name}: peak {peak / 1e9:.2f} GB, {seconds}", end="")
    assert report["peak_memory_bytes"] < 1.5e9
    image = read_image(tmp_path / "out.png")
    kept = np.round(linear_to_srgb(Scene.load(tmp_path / "scene").background) * 255)
    far = ~touched(scene, shadow)
    assert far.mean() > 0.5
    np.testing.assert_array_equal(np.round(image * 255)[far], kept[far])
