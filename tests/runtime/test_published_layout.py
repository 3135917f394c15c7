"""The published test-set layout: premultiplied layers in one EXR, estimates beside it."""

import numpy as np
import pytest
from support.scenes import make_scene

from runtime.scene_comparison import assert_same_scene
from spotlight_runtime import Scene, write_image
from spotlight_runtime.errors import ImageFileError, SceneError, ShapeError, SpotLightError
from spotlight_runtime.imaging.images import write_exr_layers
from spotlight_runtime.scenes.testset import bundle_file, load_published

NAME = "room_chair_01"
QUANTUM = 0.5 / 255 + 1e-6


def rgba(colour, alpha):
    return np.concatenate([colour, alpha[..., None]], axis=-1).astype(np.float32)


def scalar(value, alpha):
    """Value and alpha in the last two of four channels, as the release stores scalar maps."""
    nothing = np.zeros_like(value)
    return np.stack([nothing, nothing, value, alpha], axis=-1).astype(np.float32)


def layers_of(scene):
    mask, maps = scene.object_mask, scene.object_maps
    opaque = np.ones_like(mask)
    contact = (scene.footprint_depth > 0).astype(np.float32)
    return {
        "albedo": rgba(maps.albedo, mask),
        "normals": rgba(maps.normal, mask),
        "depth": scalar(maps.depth, mask),
        "roughness": scalar(maps.roughness, mask),
        "metallic": scalar(maps.metallic, mask),
        "mask": mask,
        "footprint_depth": scalar(scene.footprint_depth, contact),
        "foreground": rgba(maps.albedo, mask),
        "background": rgba(scene.background, opaque),
        "composite": rgba(scene.truth, opaque),
    }


def write_published(folder, scene, *, without=(), **changed):
    """A published scene folder; ``without`` names layers or estimates to leave out."""
    folder.mkdir()
    layers = layers_of(scene) | changed
    kept = {name: layer for name, layer in layers.items() if name not in without}
    write_exr_layers(folder / f"{NAME}_bundle0001.exr", kept)
    maps = scene.background_maps
    estimates = {
        "bg_depth.exr": maps.depth,
        "bg_normal.png": 0.5 + 0.5 * maps.normal,
        "bg_diffuse.png": maps.albedo,
        "bg_roughness.png": maps.roughness,
        "bg_metallic.png": np.repeat(maps.metallic[..., None], 3, axis=-1),
    }
    for name, image in estimates.items():
        if name not in without:
            write_image(folder / f"{NAME}_{name}", image)
    return folder


@pytest.fixture(scope="module")
def scene():
    return make_scene(24, 32)


def test_every_layer_and_estimate_is_found(tmp_path, scene):
    loaded = Scene.load(write_published(tmp_path / "s", scene))
    assert_same_scene(loaded, scene, atol=2 * QUANTUM)
    np.testing.assert_array_equal(loaded.object_maps.depth, scene.object_maps.depth)
    np.testing.assert_array_equal(loaded.background_maps.depth, scene.background_maps.depth)
    np.testing.assert_array_equal(loaded.truth, scene.truth)
    assert loaded.name == NAME


@pytest.mark.parametrize("form", ["grey", "grey with alpha", "rgba", "scalar"])
def test_mask_in_any_of_the_forms_of_a_scalar_map(tmp_path, scene, form):
    mask = scene.object_mask
    layer = {
        "grey": mask,
        "grey with alpha": np.stack([mask, mask], axis=-1),
        "rgba": np.repeat(mask[..., None], 4, axis=-1),
        "scalar": scalar(mask, mask),
    }[form]
    loaded = Scene.load(write_published(tmp_path / "s", scene, mask=layer))
    np.testing.assert_array_equal(loaded.object_mask, mask)


def test_footprint_is_unpremultiplied_and_half_covered_pixels_count(tmp_path, scene):
    depth, alpha = np.zeros((2, 24, 32), np.float32)
    depth[5, 5:8], alpha[5, 5:8] = [4.0, 2.0, 1.0], [1.0, 0.5, 0.25]
    folder = write_published(tmp_path / "s", scene, footprint_depth=scalar(depth, alpha))
    footprint = Scene.load(folder).footprint_depth
    assert footprint[5, 5:8].tolist() == [4.0, 4.0, 0.0]
    assert np.count_nonzero(footprint) == 2


def test_plain_footprint_is_taken_as_it_is(tmp_path, scene):
    folder = write_published(tmp_path / "s", scene, footprint_depth=scene.footprint_depth)
    np.testing.assert_array_equal(Scene.load(folder).footprint_depth, scene.footprint_depth)


def test_slightly_overshooting_albedo_and_mask_are_clipped(tmp_path, scene):
    white = np.broadcast_to(1.02 * scene.object_mask[..., None], scene.background.shape)
    albedo = rgba(white, scene.object_mask)
    mask = scene.object_mask * 1.01 - 0.005
    loaded = Scene.load(write_published(tmp_path / "s", scene, albedo=albedo, mask=mask))
    assert loaded.object_maps.albedo.max() == 1.0
    assert (loaded.object_mask.min(), loaded.object_mask.max()) == (0.0, 1.0)


@pytest.mark.parametrize("layer", ["background", "albedo", "mask"])
def test_missing_layer_is_named(tmp_path, scene, layer):
    folder = write_published(tmp_path / "s", scene, without=[layer])
    with pytest.raises(SceneError, match=rf"_bundle0001\.exr: expected layers .*missing {layer}$"):
        Scene.load(folder)


def test_missing_albedo_estimate_is_named(tmp_path, scene):
    folder = write_published(tmp_path / "s", scene, without=["bg_diffuse.png"])
    with pytest.raises(SceneError, match=r"_bg_diffuse\.png: expected the background's estimated"):
        Scene.load(folder)


def test_what_is_optional_may_be_missing(tmp_path, scene):
    optional = ["normals", "depth", "roughness", "metallic", "footprint_depth", "composite"]
    estimates = ["bg_depth.exr", "bg_normal.png", "bg_roughness.png", "bg_metallic.png"]
    loaded = Scene.load(write_published(tmp_path / "s", scene, without=[*optional, *estimates]))
    assert loaded.truth is None
    assert loaded.footprint_depth is None
    assert not any(loaded.has_map(name) for name in ("normal", "depth", "roughness", "metallic"))


def test_estimates_in_a_folder_of_their_own(tmp_path, scene):
    folder = write_published(tmp_path / "s", scene)
    estimates = tmp_path / "estimates"
    estimates.mkdir()
    for path in folder.glob("*_bg_*"):
        path.rename(estimates / path.name)
    with pytest.raises(SceneError, match="bg_diffuse"):
        load_published(folder)
    assert_same_scene(load_published(folder, estimates), scene, atol=2 * QUANTUM)


def test_no_bundle_here(tmp_path):
    assert bundle_file(tmp_path) is None
    assert bundle_file(tmp_path / "nowhere") is None
    with pytest.raises(SceneError, match=r"expected <name>_bundle0001\.exr, found none"):
        load_published(tmp_path)


def test_truncated_bundle_is_named(tmp_path, scene):
    folder = write_published(tmp_path / "s", scene)
    path = bundle_file(folder)
    data = path.read_bytes()
    for keep in np.linspace(0, len(data) - 1, 30).astype(int):
        path.write_bytes(data[:keep])
        with pytest.raises(ImageFileError, match=r"_bundle0001\.exr"):
            Scene.load(folder)


@pytest.mark.parametrize("estimate", ["bg_normal.png", "bg_diffuse.png", "bg_depth.exr"])
def test_estimate_of_another_size_is_an_error(tmp_path, scene, estimate):
    folder = write_published(tmp_path / "s", scene)
    other = np.full((24, 30) if "depth" in estimate else (24, 30, 3), 0.5, np.float32)
    write_image(folder / f"{NAME}_{estimate}", other)
    with pytest.raises(ShapeError, match="background"):
        Scene.load(folder)


@pytest.mark.parametrize("layer", ["background", "albedo", "normals", "depth", "footprint_depth"])
def test_nan_in_a_layer_is_an_error(tmp_path, scene, layer):
    spoiled = layers_of(scene)[layer].copy()
    spoiled[scene.footprint_depth > 0] = np.nan
    if layer == "footprint_depth":
        spoiled[..., -1] = 1.0
    with pytest.raises(SpotLightError):
        Scene.load(write_published(tmp_path / "s", scene, **{layer: spoiled}))
