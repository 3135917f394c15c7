"""Scene bundles: what is saved is what is loaded, and a malformed one is one clear error."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.scenes import make_scene

from runtime.scene_comparison import arrays_of, assert_same_scene
from spotlight_runtime import Intrinsics, Scene, write_image
from spotlight_runtime.errors import (
    ImageFileError,
    InvalidInputError,
    NonFiniteError,
    SceneError,
    ShapeError,
    SpotLightError,
    UnsafePathError,
)

QUANTUM = 0.5 / 65535 + 1e-7


@pytest.fixture
def bundle(tmp_path):
    folder = tmp_path / "scene"
    make_scene(12, 16).save(folder)
    return folder


def edit(bundle, *path, value):
    """Replace, or with ``value=...`` remove, one value of scene.json."""
    document = json.loads((bundle / "scene.json").read_text())
    target = document
    for key in path[:-1]:
        target = target[key]
    if value is ...:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    (bundle / "scene.json").write_text(json.dumps(document))


def test_round_trip(bundle):
    scene, wanted = Scene.load(bundle), make_scene(12, 16)
    assert_same_scene(scene, wanted, atol=QUANTUM)
    assert (scene.name, scene.field_of_view) == ("ball", 50.0)
    for name in ("background", "background normal", "object depth", "footprint_depth", "truth"):
        np.testing.assert_array_equal(arrays_of(scene)[name], arrays_of(wanted)[name])


def test_saved_again_nothing_changes_any_more(bundle, tmp_path):
    once = Scene.load(bundle)
    once.save(tmp_path / "again")
    assert_same_scene(Scene.load(tmp_path / "again"), once)


def test_round_trip_of_the_least_scene(tmp_path):
    full = make_scene(9, 7)
    least = Scene(
        full.background,
        Intrinsics(full.background_maps.albedo),
        Intrinsics(full.object_maps.albedo),
        full.object_mask,
        name="été — 椅子",
    )
    least.save(tmp_path / "least")
    got = Scene.load(str(tmp_path / "least"))
    assert_same_scene(got, least, atol=QUANTUM)
    assert got.name == least.name
    assert got.field_of_view is None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
@given(
    st.integers(1, 20),
    st.integers(1, 20),
    st.sets(st.sampled_from(["normal", "depth", "roughness", "metallic"])),
    st.text(max_size=10),
)
def test_round_trip_of_any_size_and_choice_of_maps(tmp_path, height, width, kept, name):
    full = make_scene(height, width)
    dropped = {key: None for key in ("normal", "depth", "roughness", "metallic") if key not in kept}
    scene = replace(full, object_maps=replace(full.object_maps, **dropped), name=name)
    scene.save(tmp_path / "scene")
    got = Scene.load(tmp_path / "scene")
    assert_same_scene(got, scene, atol=QUANTUM)
    assert got.name == name


def test_interrupted_save_is_no_scene(bundle):
    """scene.json goes last: without it there is no scene, whatever images lie there."""
    (bundle / "scene.json").unlink()
    with pytest.raises(SceneError, match="no scene here"):
        Scene.load(bundle)


def test_failed_save_over_a_scene_leaves_no_half_scene(bundle):
    (bundle / "background.exr").unlink()
    (bundle / "background.exr").mkdir()
    with pytest.raises(ImageFileError):
        make_scene(12, 16).save(bundle)
    assert not (bundle / "scene.json").exists()


@pytest.mark.parametrize("kind", ["missing", "file", "folder", "null"])
def test_no_scene_says_what_a_scene_is(tmp_path, kind):
    path = tmp_path / {"null": "a\0b"}.get(kind, kind)
    if kind == "file":
        path.write_text("chair")
    elif kind == "folder":
        path.mkdir()
    with pytest.raises(SceneError, match=r"expected a folder or zip with scene\.json"):
        Scene.load(path)


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        (["version"], 2, r"\.version: expected one of 1, got 2"),
        (["version"], ..., "missing key 'version'"),
        (["width"], "16", r"\.width: expected a whole number"),
        (["width"], 16.0, r"\.width: expected a whole number"),
        (["height"], None, r"\.height"),
        (["background"], [], r"\.background: expected an object"),
        (
            ["background", "image"],
            ...,
            r"background: expected image.*missing \['image'\]",
        ),
        (["background", "albedo"], ..., r"missing \['albedo'\]"),
        (["object", "mask"], ..., r"object: expected mask and albedo.*missing \['mask'\]"),
        (["object", "albeddo"], {"file": "a.png"}, r"unknown \['albeddo'\]"),
        (["object", "image"], {"file": "a.png"}, r"object: .*unknown \['image'\]"),
        (["object", "mask"], "mask.png", r"\.object\.mask: expected an object describing MapFile"),
        (["object", "mask", "file"], ..., r"\.object\.mask: missing key 'file'"),
        (["object", "mask", "file"], 3, r"\.object\.mask\.file: expected text"),
        (["object", "mask", "scale"], "1", r"\.object\.mask\.scale: expected a number"),
        (["object", "mask", "encoding"], "rec709", r"\.object\.mask\.encoding: expected one of"),
        (["object", "mask", "encodng"], "srgb", r"\.object\.mask: unknown key 'encodng'"),
        (["field_of_view"], "50", r"\.field_of_view: expected a number"),
        (["footprint_depth"], "f.exr", r"\.footprint_depth: expected an object"),
        (["nmae"], "ball", "unknown key 'nmae'"),
        (["name"], 7, r"\.name: expected text"),
    ],
)
def test_malformed_scene_names_file_and_path(bundle, path, value, named):
    edit(bundle, *path, value=value)
    with pytest.raises(SceneError, match=rf"scene\.json.*{named}"):
        Scene.load(bundle)


@pytest.mark.parametrize(
    "data", [b"", b"{", b"[]", b"null", b"\xff\xfe", b'{"version": NaN}', b"[" * 100_000]
)
def test_what_is_no_scene_file_names_it(bundle, data):
    (bundle / "scene.json").write_bytes(data)
    with pytest.raises(SceneError, match=r"scene\.json"):
        Scene.load(bundle)


@pytest.mark.parametrize("angle", [0, 180, -5])
def test_impossible_field_of_view(bundle, angle):
    edit(bundle, "field_of_view", value=angle)
    with pytest.raises(InvalidInputError, match="field_of_view"):
        Scene.load(bundle)


@pytest.mark.parametrize("name", ["../outside.png", "../../../etc/passwd", "sub/../../outside.png"])
def test_path_outside_the_bundle_is_refused(bundle, name):
    write_image(bundle.parent / "outside.png", np.zeros((12, 16), np.float32))
    edit(bundle, "object", "mask", "file", value=name)
    with pytest.raises(UnsafePathError, match="lies outside the bundle"):
        Scene.load(bundle)


def test_absolute_path_is_refused(bundle):
    outside = bundle.parent / "outside.png"
    write_image(outside, np.zeros((12, 16), np.float32))
    edit(bundle, "object", "mask", "file", value=str(outside))
    with pytest.raises(UnsafePathError):
        Scene.load(bundle)


def test_symlink_that_leaves_the_bundle_is_refused(bundle):
    outside = bundle.parent / "outside.png"
    write_image(outside, np.zeros((12, 16), np.float32))
    (bundle / "object_mask.png").unlink()
    (bundle / "object_mask.png").symlink_to(outside)
    with pytest.raises(UnsafePathError):
        Scene.load(bundle)


def test_symlinked_folder_that_leaves_the_bundle_is_refused(bundle):
    outside = bundle.parent / "masks"
    outside.mkdir()
    write_image(outside / "m.png", np.zeros((12, 16), np.float32))
    (bundle / "masks").symlink_to(outside)
    edit(bundle, "object", "mask", "file", value="masks/m.png")
    with pytest.raises(UnsafePathError):
        Scene.load(bundle)


def test_folder_of_a_sibling_with_the_same_beginning_is_outside(bundle):
    sibling = bundle.with_name(bundle.name + "-other")
    sibling.mkdir()
    write_image(sibling / "m.png", np.zeros((12, 16), np.float32))
    edit(bundle, "object", "mask", "file", value=f"../{sibling.name}/m.png")
    with pytest.raises(UnsafePathError):
        Scene.load(bundle)


def test_bundle_reached_through_a_symlink_is_a_scene(bundle):
    link = bundle.parent / "link"
    link.symlink_to(bundle)
    assert Scene.load(link).size == (12, 16)


def test_subfolders_and_symlinks_within_the_bundle_are_fine(bundle):
    (bundle / "maps").mkdir()
    (bundle / "object_mask.png").rename(bundle / "maps/mask.png")
    (bundle / "object_mask.png").symlink_to(bundle / "maps/mask.png")
    assert Scene.load(bundle).object_mask.max() == 1.0
    edit(bundle, "object", "mask", "file", value="maps/mask.png")
    assert Scene.load(bundle).object_mask.max() == 1.0


@pytest.mark.parametrize(
    "name", ["", ".", "a\0b.png", "a\0b.exr", "n" * 300 + ".png", "n" * 300 + ".exr", "\ud800.png"]
)
def test_names_no_file_can_have_are_errors_of_the_tree(bundle, name):
    edit(bundle, "object", "mask", "file", value=name)
    with pytest.raises(SpotLightError):
        Scene.load(bundle)


def test_symlink_to_itself_is_an_error_of_the_tree(bundle):
    (bundle / "loop.png").symlink_to(bundle / "loop.png")
    edit(bundle, "object", "mask", "file", value="loop.png")
    with pytest.raises(SpotLightError, match=r"loop\.png"):
        Scene.load(bundle)


@pytest.mark.parametrize("name", ["background.exr", "object_mask.png", "background_albedo.png"])
def test_damaged_image_is_named(bundle, name):
    path = bundle / name
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ImageFileError, match=name):
        Scene.load(bundle)
    path.unlink()
    with pytest.raises(ImageFileError, match=name):
        Scene.load(bundle)


@pytest.mark.parametrize(
    ("key", "value"), [("width", 17), ("height", 0), ("width", -16), ("height", 10**30)]
)
def test_size_other_than_the_images_is_named(bundle, key, value):
    edit(bundle, key, value=value)
    with pytest.raises(ShapeError, match=r"expected .* pixels as scene\.json says, got 16×12"):
        Scene.load(bundle)


def test_one_map_of_another_size_is_named(bundle):
    write_image(bundle / "object_mask.png", np.zeros((12, 15), np.float32))
    with pytest.raises(ShapeError, match=r"object_mask\.png: expected 16×12.*got 15×12"):
        Scene.load(bundle)


def test_grey_albedo_is_named(bundle):
    write_image(bundle / "object_albedo.png", np.zeros((12, 16), np.float32))
    with pytest.raises(ShapeError, match=r"object_albedo\.png: expected 3 channels"):
        Scene.load(bundle)


def test_nan_in_a_map_is_named(bundle):
    write_image(bundle / "object_depth.exr", np.full((12, 16), np.nan, np.float32))
    with pytest.raises(NonFiniteError, match="object depth"):
        Scene.load(bundle)


def test_colour_mask_and_albedo_with_alpha_are_read(bundle):
    rgb = np.zeros((12, 16, 3), np.float32)
    rgb[..., 0] = 1.0
    write_image(bundle / "object_mask.png", rgb)
    rgba = np.full((12, 16, 4), 0.5, np.float32)
    write_image(bundle / "object_albedo.png", rgba, bits=16)
    scene = Scene.load(bundle)
    assert (scene.object_mask == 1.0).all()
    assert scene.object_maps.albedo.shape == (12, 16, 3)


def test_encodings_are_undone(bundle):
    write_image(bundle / "p.png", np.full((12, 16, 3), 0.5, np.float32), bits=16)
    half = round(0.5 * 65535) / 65535
    for encoding, wanted in (
        ("linear", half),
        ("srgb", ((half + 0.055) / 1.055) ** 2.4),
        ("gamma22", half**2.2),
    ):
        edit(bundle, "background", "image", value={"file": "p.png", "encoding": encoding})
        np.testing.assert_allclose(Scene.load(bundle).background, wanted, rtol=1e-5)
    edit(bundle, "object", "normal", value={"file": "p.png", "encoding": "normal"})
    np.testing.assert_allclose(Scene.load(bundle).object_maps.normal, 2 * half - 1, atol=1e-6)


def test_scale_gives_units(bundle):
    write_image(bundle / "d.png", np.full((12, 16), 0.5, np.float32), bits=16)
    edit(bundle, "background", "depth", value={"file": "d.png", "scale": 10.0})
    np.testing.assert_allclose(Scene.load(bundle).background_maps.depth, 5.0, rtol=1e-4)


@pytest.mark.parametrize("scale", [1e300, -1e300, 1e39, -1.0])
def test_absurd_scale_is_an_error_of_the_tree(bundle, scale):
    edit(bundle, "background", "depth", "scale", value=scale)
    with pytest.raises(InvalidInputError, match="background depth"):
        Scene.load(bundle)


def test_saving_onto_a_file_is_said(scene, tmp_path):
    (tmp_path / "chair").write_text("not a folder")
    with pytest.raises(SceneError, match="chair: expected a folder to save in, found a file"):
        scene.save(tmp_path / "chair")
