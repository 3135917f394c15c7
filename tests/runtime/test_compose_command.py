"""``spotlight compose``, as a person types it."""

import sys

import numpy as np
import pytest
from support.models import write_box
from support.onnx_backbone import write_backbone
from support.rooms import room

from spotlight_runtime import Scene, read_image, write_image
from spotlight_runtime.cli import main
from spotlight_runtime.imaging.colour import linear_to_srgb

pytest.importorskip("embreex", reason="ray casting needs the extra scene")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A photograph of the room, its maps, and a box to put into it."""
    folder = tmp_path_factory.mktemp("inputs")
    backdrop = room(200, 150)
    write_image(folder / "room.png", linear_to_srgb(backdrop.photograph.radiance), bits=16)
    write_image(folder / "albedo.exr", backdrop.maps.albedo)
    write_image(folder / "normal.exr", backdrop.maps.normal)
    write_image(folder / "depth.exr", backdrop.maps.depth)
    write_box(folder / "box.glb", (0.6, 0.6, 0.6))
    return folder


def arguments(inputs, output, *extra, item="box.glb", maps=("albedo", "normal", "depth")):
    base = ["compose", "--background", inputs / "room.png", "--object", inputs / item]
    given = [part for name in maps for part in (f"--{name}", inputs / f"{name}.exr")]
    return [str(part) for part in (*base, *given, "--fov", 60, "-o", output, *extra)]


def run(monkeypatch, *parts):
    monkeypatch.setattr(sys, "argv", ["spotlight", *parts])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code


def test_photograph_and_model_become_a_scene(inputs, tmp_path, monkeypatch, capsys):
    command = arguments(inputs, tmp_path / "scene", "--at", "0.5,0.7", "--yaw", "30")
    assert run(monkeypatch, *command) == 0
    scene = Scene.load(tmp_path / "scene")
    assert scene.size == (150, 200)
    assert 0.01 < scene.object_mask.mean() < 0.3
    assert scene.object_mesh is not None
    assert -scene.ground.offset == pytest.approx(1.5, rel=0.02)
    assert read_image(tmp_path / "scene/preview.png").shape == (150, 200, 3)
    assert "the object covers" in capsys.readouterr().err


def test_point_in_pixels_is_the_same_as_in_fractions(inputs, tmp_path, monkeypatch):
    for name, at in (("a", "0.4,0.7"), ("b", "80,105")):
        assert run(monkeypatch, *arguments(inputs, tmp_path / name, "--at", at)) == 0
    a, b = (Scene.load(tmp_path / name) for name in "ab")
    np.testing.assert_array_equal(a.object_mask, b.object_mask)


def test_preview_elsewhere_and_size(inputs, tmp_path, monkeypatch):
    small, large = tmp_path / "small", tmp_path / "large"
    extra = ["--preview", str(tmp_path / "look.jpg"), "--size", "0.3"]
    assert run(monkeypatch, *arguments(inputs, small, *extra)) == 0
    assert (tmp_path / "look.jpg").is_file()
    assert not (small / "preview.png").exists()
    assert run(monkeypatch, *arguments(inputs, large, "--height", "0.9")) == 0
    ratio = Scene.load(large).object_mask.sum() / Scene.load(small).object_mask.sum()
    assert ratio == pytest.approx(9.0, rel=0.35)


def test_horizon_places_the_floor(inputs, tmp_path, monkeypatch):
    extra = ["--horizon", "0.19", "--camera-height", "1.5"]
    assert run(monkeypatch, *arguments(inputs, tmp_path / "scene", *extra)) == 0
    ground = Scene.load(tmp_path / "scene").ground
    assert -ground.offset == pytest.approx(1.5)
    assert ground.normal[0] == 0.0


def test_view_of_a_panorama(inputs, tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    write_image(tmp_path / "pano.hdr", rng.random((64, 128, 3), dtype=np.float32))
    command = arguments(inputs, tmp_path / "scene", "--panorama", "40,-15", "--crop", "200x150")
    command[command.index("--background") + 1] = str(tmp_path / "pano.hdr")
    assert run(monkeypatch, *command) == 0
    scene = Scene.load(tmp_path / "scene")
    assert scene.size == (150, 200)
    pitch = np.degrees(np.arctan2(scene.ground.normal[2], scene.ground.normal[1]))
    assert pitch == pytest.approx(15.0, abs=1e-3)


def test_maps_that_are_given_keep_every_detail_beside_guessed_ones(inputs, tmp_path, monkeypatch):
    """Of a picture larger than what an estimator sees details of."""
    backdrop = room(1100, 825)
    write_image(tmp_path / "room.jpg", linear_to_srgb(backdrop.photograph.radiance))
    rng = np.random.default_rng(5)
    albedo = rng.random((825, 1100, 3), dtype=np.float32)
    depth = backdrop.maps.depth + np.float32(0.5) * rng.integers(0, 2, (825, 1100))
    depth = depth.astype(np.float32)
    write_image(tmp_path / "albedo.exr", albedo)
    write_image(tmp_path / "depth.exr", depth)
    base = ["compose", "--background", tmp_path / "room.jpg", "--object", inputs / "box.glb"]
    given = ["--albedo", tmp_path / "albedo.exr", "--depth", tmp_path / "depth.exr"]
    command = [*base, *given, "--fov", 60, "--horizon", 0.19, "-o", tmp_path / "scene"]
    assert run(monkeypatch, *map(str, command)) == 0
    maps = Scene.load(tmp_path / "scene").background_maps
    np.testing.assert_allclose(maps.albedo, albedo, atol=1e-4)
    np.testing.assert_array_equal(maps.depth, depth)
    assert max(read_image(tmp_path / "scene/background_normal.exr").shape) == 1024


def test_cutout_needs_an_estimator(inputs, tmp_path, monkeypatch, capsys):
    pixels = np.zeros((40, 40, 4), np.float32)
    pixels[5:35, 5:35] = 1.0
    write_image(inputs / "cut.png", pixels)
    model = write_backbone(tmp_path / "models/tiny")
    command = arguments(inputs, tmp_path / "s", "--estimator", str(model), item="cut.png")
    assert run(monkeypatch, *command) == 1
    assert "expected a model with the graph 'intrinsics'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (["--at", "0.5"], "--at: expected two numbers"),
        (["--at", "a,b"], "--at: expected two numbers"),
        (["--at", "900,900"], "inside the picture"),
        (["--at", "0.5,0.02"], "horizon"),
        (["--size", "1", "--height", "1"], "got both"),
        (["--variant", "Oak"], "no variants"),
        (["--mask", "m.png"], "--mask: a 3-D model needs none"),
        (["--panorama", "0"], "--panorama: expected two numbers"),
        (["--panorama", "0,0", "--crop", "big"], "--crop: expected width x height"),
        (["--panorama", "0,0", "--crop", "²x²"], "--crop: expected width x height"),
        (["--panorama", "0,0", "--crop", ""], "--crop: expected width x height"),
        (["--panorama", "0,0", "--crop", "0x480"], "sides of at least 32 pixels"),
        (["--panorama", "0,0", "--crop", "-64x-64"], "sides of at least 32 pixels"),
        (["--panorama", "0,0", "--crop", f"{'9' * 5000}x64"], "--crop: expected width x height"),
        (["--panorama", "0,0", "--crop", "9999x9999"], "at most 64 megapixels"),
        (["--crop", "100x100"], "--crop: expected --panorama beside it"),
        (["--panorama", "nan,-10"], "--panorama YAW: expected degrees from -3600 to 3600, got nan"),
        (["--panorama", "0,-90"], "--panorama PITCH: expected degrees from -89 to 89, got -90"),
        (["--panorama", "0,inf"], "--panorama PITCH"),
        (["--fov", "0"], "--fov: expected degrees from 1 to 179, got 0"),
        (["--fov", "180"], "--fov: expected degrees"),
        (["--exposure", "5000"], "--exposure: expected stops from -30 to 30, got 5000"),
        (["--exposure", "200"], "--exposure: expected stops"),
        (["--exposure", "nan"], "--exposure: expected stops"),
        (["--size", "1e300"], "--size: expected metres"),
        (["--height", "inf"], "--height: expected metres"),
        (["--camera-height", "1e300"], "--camera-height: expected a camera height in metres"),
        (["--depth-scale", "0"], "--depth-scale: expected metres"),
        (["--depth-scale", "-1"], "--depth-scale: expected metres"),
        (["--horizon", "nan"], "--horizon: expected a fraction of the height from -100 to 100"),
        (["--panorama", "0,0"], "twice as wide as high"),
        (["--camera-height", "-1"], "camera height"),
        (["--preview", "look.gif"], "expected one of"),
        (["--size", "0.0005"], "too small"),
    ],
)
def test_every_mistake_is_one_line_with_a_remedy(
    inputs, tmp_path, monkeypatch, capsys, extra, said
):
    assert run(monkeypatch, *arguments(inputs, tmp_path / "scene", *extra)) == 1
    printed = capsys.readouterr().err.strip().splitlines()
    assert len(printed) == 1
    assert printed[0].startswith("spotlight: ")
    assert said in printed[0]


def test_missing_maps_without_an_estimator(inputs, tmp_path, monkeypatch, capsys):
    model = write_backbone(tmp_path / "models/tiny")
    command = arguments(inputs, tmp_path / "s", "--estimator", str(model), maps=("albedo",))
    assert run(monkeypatch, *command) == 1
    assert "--albedo, --normal and --depth" in capsys.readouterr().err


def test_cutout_has_no_variant(inputs, tmp_path, monkeypatch, capsys):
    command = arguments(inputs, tmp_path / "s", "--variant", "Oak", item="cut.png")
    assert run(monkeypatch, *command) == 1
    assert "--variant: a cut-out has none" in capsys.readouterr().err
