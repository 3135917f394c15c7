"""The trainings learn, resume, and end as a model the runtime runs."""

import json
import shutil
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the training extra")

from support.scenes import make_scene, make_shadow  # noqa: E402

from spotlight_runtime import Relighter, RelightOptions  # noqa: E402
from spotlight_runtime.networks.models import open_networks, resolve_model  # noqa: E402
from spotlight_training import runs  # noqa: E402
from spotlight_training.data import (  # noqa: E402
    LIGHTS,
    SIDE,
    IntrinsicsData,
    Packed,
    PictureData,
    RendererData,
    draw_picture,
)
from spotlight_training.data import _scene_dtype as scene_dtype  # noqa: E402
from spotlight_training.loop import TrainingOptions, train  # noqa: E402
from spotlight_training.networks import VAE, IntrinsicsNet  # noqa: E402
from spotlight_training.objectives import vae_loss  # noqa: E402
from spotlight_training.restore import restore  # noqa: E402
from spotlight_training.ship import ship  # noqa: E402


def made_up_scenes(count=2):
    """A coloured disc on a plain floor; each light brightens another side of the picture."""
    scenes = np.zeros(count, scene_dtype(SIDE, LIGHTS))
    rows, columns = np.mgrid[:SIDE, :SIDE] / SIDE
    for number, scene in enumerate(scenes):
        disc = np.hypot(rows - 0.5, columns - 0.4 - 0.1 * number) < 0.2
        albedo = np.where(disc[..., None], [0.8, 0.3, 0.2], [0.5, 0.55, 0.6])
        scene["albedo"] = 255 * albedo
        scene["normal"] = [128, 255, 128]
        scene["depth"] = 3.0 - rows
        scene["object_mask"] = 255 * disc
        scene["ambient"] = scene["ambient_background"] = 0.3 * albedo
        for light in range(LIGHTS):
            side = (rows, columns, 1 - rows, 1 - columns)[light % 4][..., None]
            scene["lights"][light] = scene["lights_background"][light] = side * albedo
        scene["ambient_weight"] = 1.0
    return scenes


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    path = tmp_path_factory.mktemp("packed") / "scenes.pack"
    made_up_scenes().tofile(path)
    return path


@pytest.fixture(scope="module")
def trained(packed, tmp_path_factory):
    """All three trainings, a few steps each."""
    house = tmp_path_factory.mktemp("runs")
    few = TrainingOptions(steps=2, batch=1, sample_every=2, warmup=1, samples=1)
    runs.train_vae(packed, packed, house / "vae", few, latent=4, width=8, side=64)
    runs.train_renderer(packed, packed, house / "vae", house / "renderer", few, width=64, side=64)
    runs.train_intrinsics(packed, packed, house / "intrinsics", few, side=64)
    return house


def test_pictures_are_the_sum_of_their_lights(packed):
    scene = Packed(packed)[0]
    picture = draw_picture(scene, np.random.default_rng(3), 128)
    assert picture.image.shape == (128, 128, 3)
    assert 0.0 <= picture.image.min() < picture.image.max() <= 1.0
    # Both layers are lit alike here, so whatever was composed shows albedo under one smooth light.
    shading = picture.image**2.2 / picture.maps["albedo"]
    inside = picture.object_mask > 0.99
    neighbours = np.roll(inside, 4, axis=1) & inside
    steps = np.abs(shading - np.roll(shading, 4, axis=1))[neighbours]
    assert np.percentile(steps, 95) < 0.15
    np.testing.assert_allclose(np.linalg.norm(picture.maps["normal"], axis=2), 1.0, atol=1e-3)


def test_the_same_generator_draws_the_same_sample(packed):
    spec = runs.BACKBONES["mini"]
    for data in (RendererData(Packed(packed), spec, 64), IntrinsicsData(Packed(packed), 64)):
        one, other = (data(np.random.default_rng(5)) for _ in range(2))
        assert all(np.array_equal(one[name], other[name]) for name in one)


def test_shading_is_hidden_somewhere_and_known_elsewhere(packed):
    data = RendererData(Packed(packed), runs.BACKBONES["mini"], 64)
    rng = np.random.default_rng(0)
    masks = [data(rng)["conditioning"][10] for _ in range(24)]
    assert all(set(np.unique(mask)) <= {-1.0, 1.0} for mask in masks)
    assert any((mask == 1.0).any() for mask in masks)
    assert all((mask == -1.0).any() for mask in masks)


def test_latents_are_standardised_principal_components():
    generator = torch.Generator().manual_seed(0)
    patches = torch.randn(4000, 192, generator=generator, dtype=torch.float64)
    patches *= torch.linspace(3.0, 0.1, 192, dtype=torch.float64)
    vae = VAE(latent=6, width=8)
    deviations = vae.fit_patches(patches + 0.5)
    assert (deviations[:-1] >= deviations[1:]).all()
    image = (patches[:64] + 0.5).float().reshape(64, 3, 8, 8)
    with torch.no_grad():
        latents = vae.encode(image)[0].flatten(1)
        decoded = vae.synthesis(vae.encode(image)[0])
    assert latents.mean().abs() < 0.2
    torch.testing.assert_close(latents.std(dim=0), torch.ones(6), atol=0.35, rtol=0)
    # The best linear autoencoder leaves what the other components hold.
    left = (decoded - image).square().sum() / 64
    rest = patches.var(dim=0).sort(descending=True).values[6:].sum()
    assert left == pytest.approx(float(rest), rel=0.1)


def test_a_start_is_as_much_brighter_in_pictures(trained):
    renderer, spec = runs.load_renderer(trained / "renderer")
    begun = runs.starting(renderer, spec, -0.04, 0.25)
    assert begun.latent.start_deviation == 0.25
    assert replace(begun, latent=spec.latent) == spec
    mean = torch.tensor(begun.latent.start_mean)
    grey = torch.full((1, 3, 8, 8), 0.2)
    with torch.no_grad():
        darker = renderer.vae.analysis(grey - 2 * 0.04) - renderer.vae.analysis(grey)
    torch.testing.assert_close(darker[0, :, 0, 0], mean, atol=1e-4, rtol=0)
    assert runs.starting(renderer, spec, 0.0, 1.0) == spec


def test_a_killed_run_goes_on_where_it_stopped(packed, tmp_path):
    options = TrainingOptions(steps=5, batch=1, sample_every=2, warmup=1)
    draw, no_sheet = PictureData(Packed(packed), 64), lambda *_: None
    network = VAE(4, 8)
    whole = train(deepcopy(network), vae_loss, draw, tmp_path / "whole", options, no_sheet)
    left = iter(range(3))

    def killed(*given):
        if next(left, None) is None:
            raise RuntimeError("killed")
        return vae_loss(*given)

    with pytest.raises(RuntimeError, match="killed"):
        train(network, killed, draw, tmp_path / "killed", options, no_sheet)
    # Of other weights: all that is the same in the end comes from the checkpoint.
    resumed = train(VAE(4, 8), vae_loss, draw, tmp_path / "killed", options, no_sheet)
    torch.testing.assert_close(resumed.state_dict(), whole.state_dict(), rtol=0, atol=0)
    rows, again = ((tmp_path / run / "loss.csv").read_text() for run in ("whole", "killed"))
    assert again == rows
    assert [line.split(",")[0] for line in rows.splitlines()] == ["step", *"01234"]


def stop_at_once(packed, run):
    """A VAE run that ends in its first step: no crop of a scene is that large."""
    options = TrainingOptions(steps=4, batch=1, samples=1)
    with pytest.raises(ValueError, match="low >= high"):
        runs.train_vae(packed, packed, run, options, latent=4, width=8, side=2 * SIDE)


def test_a_vae_that_was_stopped_has_latents_and_no_decoder_to_ship(packed, trained, tmp_path):
    renderer, _ = runs.load_renderer(trained / "renderer")
    stop_at_once(packed, tmp_path / "stopped")
    none = TrainingOptions(steps=0, samples=1)
    runs.train_vae(packed, packed, tmp_path / "latents", none, latent=4, width=8, side=64)
    for run in ("stopped", "latents"):
        vae, _ = runs.load_vae(tmp_path / run)
        assert torch.equal(vae.analysis.weight, renderer.vae.analysis.weight)
        with pytest.raises(ValueError, match=f"{run}: expected a trained decoder"):
            runs.take_decoder(renderer, tmp_path / run)


def test_resuming_a_vae_leaves_what_was_finished_until_it_is_again(packed, trained, tmp_path):
    run = shutil.copytree(trained / "vae", tmp_path / "vae")
    finished = (run / "model.safetensors").read_bytes()
    stop_at_once(packed, run)
    assert (run / "model.safetensors").read_bytes() == finished
    renderer, _ = runs.load_renderer(trained / "renderer")
    runs.take_decoder(renderer, run)
    decoder, _ = runs.load_vae(run)
    torch.testing.assert_close(renderer.vae.state_dict(), decoder.state_dict())


def test_a_decoder_of_other_latents_is_refused(trained, tmp_path):
    renderer, _ = runs.load_renderer(trained / "renderer")
    runs.save_run(tmp_path, VAE(4, 8), {"latent": 4, "width": 8})
    with pytest.raises(ValueError, match="its latents are not those"):
        runs.take_decoder(renderer, tmp_path)


def test_run_folders_show_curve_and_samples(trained):
    for name in ("vae", "renderer", "intrinsics"):
        assert {"loss.csv", "loss.png", "samples.png", "model.safetensors"} <= {
            path.name for path in (trained / name).iterdir()
        }


def test_who_trained_goes_on_with_the_smallest_floats(trained):
    assert np.float32(1e-40) * np.float32(0.5) > 0
    assert torch.tensor(1e-40) * 0.5 > 0


def test_an_unfinished_training_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="finished training"):
        runs.load_renderer(tmp_path)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_shipped_model_is_verified_and_relights(trained, tmp_path):
    renderer, spec = runs.load_renderer(trained / "renderer")
    estimator = runs.load_estimator(trained / "intrinsics")
    assert isinstance(estimator, IntrinsicsNet)
    manifest = ship(renderer, estimator, spec, tmp_path / "mini", {"data": "made up"})
    assert {row.subject for row in manifest.parity} == {
        "vae_encoder", "condition_encoder", "denoiser", "denoiser_shallow", "vae_decoder",
        "intrinsics", "loop",
    }  # fmt: skip
    assert all(row.max_rel <= row.tolerance for row in manifest.parity)
    assert json.loads((tmp_path / "mini/manifest.json").read_text())["licence"] == "Apache-2.0"
    scene = make_scene(64, 64)
    result = Relighter.load(tmp_path / "mini").relight(
        scene, make_shadow(scene), options=RelightOptions(steps=2)
    )
    assert np.isfinite(result.image).all()
    reused = Relighter.load(tmp_path / "mini").relight(
        scene, make_shadow(scene), options=RelightOptions(steps=2, reuse=2)
    )
    assert reused.plan.shallow == 3
    assert np.isfinite(reused.image).all()
    vae, folder, _ = restore(tmp_path / "mini", tmp_path / "again")
    restored, _ = runs.load_renderer(folder)
    runs.take_decoder(restored, vae)
    again = restored.state_dict()
    for name, value in renderer.state_dict().items():
        torch.testing.assert_close(again[name], value, rtol=1e-3, atol=1e-6)
    again = runs.load_estimator(tmp_path / "again/intrinsics").state_dict()
    for name, value in estimator.state_dict().items():
        torch.testing.assert_close(again[name], value, rtol=1e-3, atol=1e-6)
    estimate = open_networks(resolve_model(tmp_path / "mini"))["intrinsics"]
    maps = estimate(image=np.full((1, 3, 64, 96), 0.5, np.float32))["maps"]
    assert maps.shape == (1, 7, 64, 96)
    np.testing.assert_allclose(np.linalg.norm(maps[:, 3:6], axis=1), 1.0, atol=1e-3)


def test_a_deeper_renderer_starts_where_a_shallower_one_ended(packed, trained, tmp_path):
    none = TrainingOptions(steps=1, batch=1, sample_every=1, learning_rate=0.0, samples=1)
    vae, start = trained / "vae", trained / "renderer"
    before, spec = runs.load_renderer(start)
    depth = len(before.denoiser.deep) + 2
    runs.train_renderer(
        packed, packed, vae, tmp_path, none, width=64, side=64, start=start, depth=depth
    )
    after, _ = runs.load_renderer(tmp_path)
    assert len(after.denoiser.deep) == depth
    conditioning = torch.rand(
        (1, spec.conditioning_channels, 64, 64), generator=torch.Generator().manual_seed(0)
    )
    with torch.no_grad():
        latents, t = torch.ones(1, spec.latent.channels, 8, 8), torch.tensor([500])
        one, other = (
            model.denoiser(latents, t, model.condition(conditioning)) for model in (before, after)
        )
    torch.testing.assert_close(one, other)
    with pytest.raises(ValueError, match="expected a renderer of the same width"):
        runs.train_renderer(
            packed, packed, vae, tmp_path / "wide", none, width=64, side=64, start=start, depth=1
        )


def test_some_steps_see_more_pictures_of_half_the_side(packed, trained, tmp_path):
    seen = []
    model = torch.nn.Linear(1, 1)

    def loss(network, batch, generator):
        seen.append(tuple(batch["image"].shape))
        return {"one": network.weight.sum() * 0.0 + 1.0}

    spec = runs.BACKBONES["mini"]
    fine, coarse = (RendererData(Packed(packed), spec, side) for side in (64, 32))
    options = TrainingOptions(steps=4, batch=1, sample_every=9, warmup=1, coarse_every=2)
    train(model, loss, fine, tmp_path, options, lambda *_: None, coarse)
    assert seen == [(4, 3, 32, 32), (1, 3, 64, 64)] * 2
