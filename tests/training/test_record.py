"""Records on disk: what comes back, how exact it is, and how damage is reported."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the data renderer needs the training packages")

from spotlight_training.render import codec
from spotlight_training.render.record import MapSet, SceneRecord, is_whole, record_path
from spotlight_training.render.scenes import SceneOptions, describe
from spotlight_training.render.sheet import write_sheet

SIDE = 24


def make_record(options=None) -> SceneRecord:
    rng = np.random.default_rng(0)
    scene = describe("test", 2, options or SceneOptions(lights=2))

    def plane():
        return rng.random((SIDE, SIDE), dtype=np.float32)

    def colour():
        return rng.random((SIDE, SIDE, 3), dtype=np.float32)

    def maps(alpha):
        normal = colour() * 2 - 1
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        return MapSet(colour(), normal, plane() * 9 + 1, plane(), plane(), alpha)

    names = [light.name for light in scene.lights]
    return SceneRecord(
        description=scene,
        background=maps(np.ones((SIDE, SIDE), np.float32)),
        object=maps(plane()),
        footprint_depth=plane() * 5,
        lights={name: colour() * 3 for name in names},
        lights_background={name: colour() * 3 for name in names},
        ambient=colour(),
        ambient_background=colour(),
        shadows={name: plane() for name in names},
    )


def test_round_trip_is_exact_to_the_promised_steps(tmp_path):
    record = make_record()
    path = record_path(tmp_path, "test", 2)
    record.save(path)
    assert path.name == "000002.scene.zip"
    assert is_whole(path)
    assert list(path.parent.iterdir()) == [path]
    loaded = SceneRecord.load(path)
    assert loaded.description == record.description
    assert set(loaded.lights) == set(record.lights)
    for name, image in record.lights.items():
        np.testing.assert_allclose(loaded.lights[name], image, rtol=2e-3, atol=1e-5)
        np.testing.assert_allclose(
            loaded.lights_background[name], record.lights_background[name], rtol=2e-3, atol=1e-5
        )
        np.testing.assert_allclose(
            loaded.shadows[name], record.shadows[name], atol=0.5 / 255 + 1e-6
        )
    np.testing.assert_allclose(loaded.ambient, record.ambient, rtol=2e-3, atol=1e-5)
    for layer in ("background", "object"):
        old, new = getattr(record, layer), getattr(loaded, layer)
        np.testing.assert_allclose(new.depth, old.depth, atol=codec.DEPTH_STEP / 2 + 1e-5)
        np.testing.assert_allclose(new.alpha, old.alpha, atol=0.5 / 255 + 1e-6)
        np.testing.assert_allclose(new.albedo ** (1 / 2.2), old.albedo ** (1 / 2.2), atol=0.003)
        seen = new.alpha > 0
        np.testing.assert_allclose(new.normal[seen], old.normal[seen], atol=0.01)
    np.testing.assert_allclose(loaded.footprint_depth, record.footprint_depth, atol=0.0003)
    for array in (loaded.ambient, loaded.background.depth, loaded.object.normal):
        assert array.dtype == np.float32


def test_equal_records_give_equal_bytes(tmp_path):
    make_record().save(tmp_path / "a.scene.zip")
    make_record().save(tmp_path / "b.scene.zip")
    assert (tmp_path / "a.scene.zip").read_bytes() == (tmp_path / "b.scene.zip").read_bytes()


def test_lightings_add_up_linearly():
    record = make_record()
    first, second = record.lights
    both = record.radiance({first: 0.5, second: (1.0, 0.0, 2.0)}, ambient=0.25)
    expected = (
        0.5 * record.lights[first]
        + record.lights[second] * np.array([1.0, 0.0, 2.0])
        + 0.25 * record.ambient
    )
    np.testing.assert_allclose(both, expected, rtol=1e-5)
    image = record.image({first: 1.0}, ambient=0.0, exposure=2.0, with_object=False)
    linear = np.clip(2.0 * record.lights_background[first], 0, 1)
    np.testing.assert_allclose(image, linear ** (1 / 2.2), rtol=1e-4)
    default = record.radiance({})
    np.testing.assert_allclose(
        default, record.ambient * record.description.ambient.weight, rtol=1e-5
    )


def test_composed_maps_lie_over_the_background_by_alpha():
    record = make_record()
    solid = dataclasses.replace(record.object, alpha=np.ones((SIDE, SIDE), np.float32))
    none = dataclasses.replace(record.object, alpha=np.zeros((SIDE, SIDE), np.float32))
    over = dataclasses.replace(record, object=solid).composed()
    under = dataclasses.replace(record, object=none).composed()
    np.testing.assert_allclose(over.depth, record.object.depth)
    np.testing.assert_allclose(under.albedo, record.background.albedo)
    np.testing.assert_allclose(np.linalg.norm(record.composed().normal, axis=2), 1.0, atol=1e-5)


def test_an_unknown_light_is_named():
    with pytest.raises(KeyError, match="got sun"):
        make_record().radiance({"sun": 1.0})


def test_a_missing_and_a_cut_file_are_told_apart(tmp_path):
    with pytest.raises(FileNotFoundError, match="spotlight-train render"):
        SceneRecord.load(tmp_path / "none.scene.zip")
    path = tmp_path / "cut.scene.zip"
    make_record().save(path)
    path.write_bytes(path.read_bytes()[:2000])
    assert not is_whole(path)
    with pytest.raises(ValueError, match="Delete it and render"):
        SceneRecord.load(path)


def test_export_writes_the_published_layout(tmp_path):
    exr = pytest.importorskip("OpenEXR", reason="the test-set exporter writes OpenEXR")
    from spotlight_training.render.testset import export_folder

    record = make_record(SceneOptions(evaluation=True))
    record.save(record_path(tmp_path / "records", "test", 2))
    (folder,) = export_folder(tmp_path / "records", tmp_path / "out")
    names = {path.name for path in folder.iterdir()}
    directions = [f"{i:04d}" for i in range(8)] + ["gt_dir"]
    expected = {f"shadow_{sign}_{d}.png" for sign in ("positive", "negative") for d in directions}
    expected |= {f"truth_{d}.exr" for d in directions[:8]} | {"meta.json"}
    stem = "test_000002"
    expected |= {f"{stem}_bundle0001.exr", f"{stem}_bg_depth.exr"}
    expected |= {f"{stem}_bg_{m}.png" for m in ("normal", "diffuse", "roughness", "metallic")}
    assert names == expected
    with exr.File(str(folder / f"{stem}_bundle0001.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    layers = ("albedo", "background", "composite", "depth", "footprint_depth", "foreground")
    layers += ("metallic", "normals", "roughness")
    assert set(channels) == {f"{layer}.{c}" for layer in layers for c in "RGBA"} | {"mask.R"}
    alpha = codec.decode_unit(codec.encode_unit(record.object.alpha))
    np.testing.assert_allclose(channels["mask.R"], alpha, atol=1e-3)
    np.testing.assert_allclose(channels["depth.B"], record.object.depth * alpha, atol=2e-3)


def test_a_scene_of_an_external_object_is_exported_with_its_mesh(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="external objects are read by trimesh")
    testing = pytest.importorskip("typer.testing", reason="the command line needs typer")
    from spotlight_runtime import Scene
    from spotlight_training.cli import app

    (tmp_path / "objects").mkdir()
    trimesh.creation.box(extents=(0.4, 0.8, 0.2)).export(tmp_path / "objects" / "crate.glb")
    record = make_record(SceneOptions(evaluation=True))
    subject = dataclasses.replace(record.description.subject, kind="file:crate.glb")
    description = dataclasses.replace(record.description, subject=subject)
    path = tmp_path / "000002.scene.zip"
    dataclasses.replace(record, description=description).save(path)
    command = ["export-scene", str(path), "-o", str(tmp_path / "scene")]
    refused = testing.CliRunner().invoke(app, command)
    assert "Pass --objects DIR" in str(refused.exception)
    done = testing.CliRunner().invoke(app, [*command, "--objects", str(tmp_path / "objects")])
    assert done.exception is None, done.output
    assert len(Scene.load(tmp_path / "scene").object_mesh.faces) == 12


def test_packed_are_records_of_the_side_that_trainings_open(tmp_path):
    from spotlight_training.data import Packed, pack

    path = record_path(tmp_path, "test", 2)
    make_record().save(path)
    out = tmp_path / "packed" / "test.pack"
    with pytest.raises(ValueError, match="256×256 pixels, found 24×24; render it with --size 256"):
        pack(path.parent, out)
    assert list(out.parent.iterdir()) == []
    assert pack(path.parent, out, side=SIDE) == len(Packed(out, side=SIDE)) == 1


def test_export_names_an_empty_folder(tmp_path):
    pytest.importorskip("OpenEXR", reason="the test-set exporter writes OpenEXR")
    from spotlight_training.render.testset import export_folder

    with pytest.raises(FileNotFoundError, match="found none"):
        next(export_folder(tmp_path, tmp_path / "out"))


def test_truth_of_another_light_keeps_the_photograph_and_lights_the_object():
    from spotlight_training.render.truth import relit_truth

    record = make_record()
    one, other = record.lights
    rows = np.arange(SIDE)[:, None] * np.ones((1, SIDE))
    alpha = np.where(rows < 8, 1.0, np.where(rows == 8, 0.5, 0.0)).astype(np.float32)
    grey = np.ones((SIDE, SIDE, 3), np.float32)
    shadow = np.where(rows < 16, 0.25, 1.0)[..., None].astype(np.float32)
    behind, own = 0.8 * grey, 0.3 * grey
    seen = alpha[..., None] * own + (1 - alpha[..., None]) * shadow * behind
    record = dataclasses.replace(
        record,
        object=dataclasses.replace(record.object, alpha=alpha),
        lights={one: grey, other: seen},
        lights_background={one: grey, other: behind},
        ambient=0 * grey,
        ambient_background=0 * grey,
    )
    photograph = 0.1 + 0.5 * np.random.default_rng(1).random((SIDE, SIDE, 3), dtype=np.float32)
    truth = relit_truth(record, other, photograph, exposure=2.0)
    expected = alpha[..., None] * own * 2.0 + (1 - alpha[..., None]) * shadow * photograph
    np.testing.assert_allclose(truth, expected, rtol=1e-5)
    assert truth.dtype == np.float32


def test_truth_never_brightens_the_photograph():
    from spotlight_training.render.truth import relit_truth

    record = make_record()
    none = dataclasses.replace(record.object, alpha=np.zeros((SIDE, SIDE), np.float32))
    record = dataclasses.replace(record, object=none)
    photograph = np.full((SIDE, SIDE, 3), 0.4, np.float32)
    truth = relit_truth(record, next(iter(record.lights)), photograph, exposure=1.0)
    assert truth.max() <= photograph.max()
    assert truth.min() < 0.2


def test_two_processes_may_write_one_contact_sheet(tmp_path):
    """Those that share a range of seeds write the same sheet, at times in the same moment."""
    sheet = tmp_path / "sheet_000000.png"
    rows = [np.zeros((8, 480, 3), np.uint8)]
    with ThreadPoolExecutor(4) as several:
        list(several.map(lambda _: write_sheet(sheet, rows), range(64)))
    assert list(tmp_path.iterdir()) == [sheet]
