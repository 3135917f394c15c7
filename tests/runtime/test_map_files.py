"""Maps of large photographs in parts and at their own detail, and photographs as they came."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.scenes import make_scene

from runtime.scene_comparison import arrays_of
from spotlight_runtime import Scene, write_image
from spotlight_runtime.composing.photograph import read_photograph
from spotlight_runtime.errors import ShapeError
from spotlight_runtime.imaging.colour import decode_to_linear, stored_to_linear
from spotlight_runtime.scenes.bundle import save_bundle
from spotlight_runtime.scenes.map_files import (
    MapFile,
    covered_box,
    read_map_file,
    write_part,
    write_reduced,
)

LARGE = (1100, 1000)


@pytest.mark.parametrize("encoding", ["linear", "srgb", "gamma22"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tables_say_what_the_curves_say(rng, encoding, dtype):
    top = np.iinfo(dtype).max
    pixels = rng.integers(0, top + 1, (50, 40, 3), dtype=dtype)
    wanted = decode_to_linear(pixels.astype(np.float32) / np.float32(top), encoding)
    np.testing.assert_array_equal(stored_to_linear(pixels, encoding), wanted)
    floats = rng.random((5, 4), dtype=np.float32)
    np.testing.assert_array_equal(
        stored_to_linear(floats, encoding), decode_to_linear(floats, encoding)
    )


def test_box_of_a_mask():
    mask = np.zeros((9, 7), np.float32)
    assert covered_box(mask) == (0, 0, 0, 0)
    mask[2, 5] = mask[6, 3] = 0.1
    assert covered_box(mask) == (2, 7, 3, 6)


@pytest.mark.parametrize("name", ["depth.exr", "mask.png"])
def test_part_of_a_map_comes_back_in_its_place(tmp_path, rng, name):
    value = np.zeros(LARGE, np.float32)
    value[100:200, 300:450] = rng.random((100, 150), dtype=np.float32)
    entry = write_part(tmp_path, name, value, covered_box(value))
    assert entry.corner == (300, 100)
    assert cv2.haveImageReader(str(tmp_path / "mask.png")) or name.endswith("exr")
    found = read_map_file(tmp_path / name, entry, 1, LARGE)
    np.testing.assert_allclose(found, value, atol=1e-5)
    assert found.dtype == np.float32


def test_small_or_nearly_full_maps_are_stored_whole(tmp_path):
    small = np.zeros((60, 50), np.float32)
    small[3, 4] = 1.0
    assert write_part(tmp_path, "a.png", small, covered_box(small)).corner is None
    full = np.ones(LARGE, np.float32)
    assert write_part(tmp_path, "b.png", full, covered_box(full)).corner is None
    empty = np.zeros(LARGE, np.float32)
    assert write_part(tmp_path, "c.png", empty, covered_box(empty)).corner is None


@pytest.mark.parametrize("corner", [(-1, 0), (0, -1), (991, 0), (0, 1091)])
def test_part_that_does_not_fit_is_named(tmp_path, corner):
    write_image(tmp_path / "m.png", np.ones((10, 10), np.float32))
    with pytest.raises(ShapeError, match=r"m\.png: expected a part of the scene's 1000×1100"):
        read_map_file(tmp_path / "m.png", MapFile("m.png", corner=corner), 1, LARGE)


def test_smooth_map_survives_being_reduced(tmp_path):
    rows, columns = np.mgrid[: LARGE[0], : LARGE[1]].astype(np.float32)
    depth = 2.0 + rows / 500 + np.sin(columns / 200)
    entry = write_reduced(tmp_path, "depth.exr", depth, 256)
    assert entry.enlarged
    found = read_map_file(tmp_path / "depth.exr", entry, 1, LARGE)
    np.testing.assert_allclose(found[5:-5, 5:-5], depth[5:-5, 5:-5], atol=0.01)
    assert not write_reduced(tmp_path, "depth.exr", depth, 5000).enlarged


def test_file_larger_than_the_scene_is_not_an_enlargement(tmp_path):
    write_image(tmp_path / "d.exr", np.ones((20, 20), np.float32))
    with pytest.raises(ShapeError, match=r"expected 10×10 pixels as scene\.json says"):
        read_map_file(tmp_path / "d.exr", MapFile("d.exr", enlarged=True), 1, (10, 10))


def large_scene():
    """A scene of more than a megapixel with a small object."""
    small = make_scene(110, 100)
    grown = {}
    for name in ("background", "object_mask", "footprint_depth"):
        grown[name] = cv2.resize(getattr(small, name), LARGE[::-1])
    maps = {}
    for owner in ("background_maps", "object_maps"):
        values = getattr(small, owner)
        maps[owner] = replace(
            values,
            **{
                name: cv2.resize(getattr(values, name), LARGE[::-1])
                for name in ("albedo", "normal", "depth", "roughness", "metallic")
            },
        )
    cover = np.zeros(LARGE, np.float32)
    cover[400:700, 350:650] = 1.0
    maps["object_maps"] = replace(
        maps["object_maps"],
        **{
            name: value * (cover if value.ndim == 2 else cover[..., None])
            for name, value in vars_of(maps["object_maps"])
        },
    )
    grown["object_mask"] = np.clip(grown["object_mask"] * cover, 0.0, 1.0)
    grown["footprint_depth"] = grown["footprint_depth"] * cover
    return replace(small, **grown, **maps, truth=None)


def vars_of(maps):
    return [(n, getattr(maps, n)) for n in ("albedo", "normal", "depth", "roughness", "metallic")]


def test_large_scene_survives_its_bundle(tmp_path):
    scene = large_scene()
    scene.save(tmp_path)
    assert sum(file.stat().st_size for file in tmp_path.glob("object_*")) < 4_000_000
    found = arrays_of(Scene.load(tmp_path))
    for name, value in arrays_of(scene).items():
        np.testing.assert_allclose(found[name], value, atol=1e-4, err_msg=name)


def test_estimated_maps_are_stored_with_the_detail_they_have(tmp_path):
    scene = large_scene()
    save_bundle(scene, tmp_path, working_side=400)
    loaded = Scene.load(tmp_path)
    np.testing.assert_array_equal(loaded.background, scene.background)
    assert np.abs(loaded.background_maps.albedo - scene.background_maps.albedo).mean() < 0.02
    assert np.abs(loaded.background_maps.depth - scene.background_maps.depth).mean() < 0.01
    np.testing.assert_allclose(loaded.object_maps.depth, scene.object_maps.depth, atol=1e-5)


@pytest.mark.parametrize("guessed", [(), ("normal",), ("albedo", "depth")])
def test_maps_that_are_not_estimated_keep_every_detail(tmp_path, guessed):
    scene = large_scene()
    save_bundle(scene, tmp_path, working_side=400, estimated=guessed)
    loaded = Scene.load(tmp_path).background_maps
    for name, value in vars_of(scene.background_maps):
        off = np.abs(getattr(loaded, name) - value).max()
        smooth = name in ("roughness", "metallic", "normal")  # as this scene has them
        assert (off < 1e-4) == (smooth or name not in guessed), name
    assert (tmp_path / "background_albedo.jpg").exists() == ("albedo" in guessed)


@pytest.mark.parametrize("name", ["p.jpg", "p.png", "p.webp"])
def test_photograph_is_kept_as_it_came(tmp_path, rng, name):
    write_image(tmp_path / name, rng.random((64, 96, 3), dtype=np.float32))
    photograph = read_photograph(tmp_path / name)
    scene = replace(make_scene(64, 96), background=photograph.radiance)
    assert photograph.file == tmp_path / name
    save_bundle(scene, tmp_path / "scene", photograph=photograph.file)
    kept = tmp_path / f"scene/background{photograph.file.suffix}"
    assert kept.read_bytes() == (tmp_path / name).read_bytes()
    loaded = Scene.load(tmp_path / "scene")
    np.testing.assert_array_equal(loaded.background, photograph.radiance)


def test_photograph_that_is_not_its_file_any_more(tmp_path, rng):
    write_image(tmp_path / "p.png", rng.random((64, 96, 3), dtype=np.float32))
    write_image(tmp_path / "grey.png", rng.random((64, 96), dtype=np.float32))
    write_image(tmp_path / "p.exr", rng.random((64, 96, 3), dtype=np.float32))
    assert read_photograph(tmp_path / "p.png", exposure=0.5).file is None
    assert read_photograph(tmp_path / "grey.png").file is None
    assert read_photograph(tmp_path / "p.exr").file is None
