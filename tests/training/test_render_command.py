"""The command line of the data renderer, and what it reads from folders."""

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the data renderer needs the training packages")
typer_testing = pytest.importorskip("typer.testing", reason="the command line needs typer")

from spotlight_training import cli  # noqa: E402
from spotlight_training.render import panoramas  # noqa: E402
from spotlight_training.render.description import Ambient  # noqa: E402
from spotlight_training.render.record import SceneRecord  # noqa: E402

RUNNER = typer_testing.CliRunner()


def test_render_resumes_where_it_stopped(tmp_path):
    pytest.importorskip("mitsuba", reason="the path tracer needs mitsuba")
    pytest.importorskip("pyoidn", reason="the renderer's denoiser needs pyoidn")
    from spotlight_training.render.variant import RendererUnavailableError, select_variant

    try:
        select_variant("auto", threads=1)
    except RendererUnavailableError as error:
        pytest.skip(str(error))
    command = ["render", "-o", str(tmp_path), "--size", "32", "--spp", "4", "--lights", "2"]
    command += ["--no-hdris", "--threads", "1", "--first-seed", "7"]
    first = RUNNER.invoke(cli.app, [*command, "--count", "1"])
    assert first.exit_code == 0, first.output
    path = tmp_path / "train" / "000007.scene.zip"
    written = path.stat().st_mtime_ns
    second = RUNNER.invoke(cli.app, [*command, "--count", "2"])
    assert second.exit_code == 0, second.output
    assert path.stat().st_mtime_ns == written
    assert "000008.scene.zip" in second.output
    assert "000007.scene.zip" not in second.output
    assert SceneRecord.load(path).description.seed == 7
    assert (tmp_path / "train" / "sheet_000000.png").exists()
    assert len((tmp_path / "train" / "render.jsonl").read_text().splitlines()) == 2


def test_missing_panoramas_are_named_with_three_ways_out(tmp_path):
    pytest.importorskip("OpenEXR", reason="panoramas are OpenEXR files")
    from spotlight_training.render.sky import sky_image

    grey = ((0.5, 0.5, 0.5),) * 3
    with pytest.raises(FileNotFoundError, match=r"expected city\.exr .* --no-hdris"):
        sky_image(Ambient("hdri", "city", 0.0, grey, 0.3), tmp_path)


def test_panoramas_are_tamed_turned_and_scaled(tmp_path):
    pytest.importorskip("OpenEXR", reason="panoramas are OpenEXR files")
    from spotlight_training.render import exr
    from spotlight_training.render.sky import PEAK, floor_radiance, sky_image

    image = np.full((64, 128, 3), 0.5, np.float32)
    image[10:14, 20:24] = 5000.0
    exr.write(tmp_path / "city.exr", {c: image[..., i] for i, c in enumerate("RGB")})
    grey = ((0.5, 0.5, 0.5),) * 3
    sky = sky_image(Ambient("hdri", "city", 0.0, grey, 0.3), tmp_path)
    assert sky.shape == (128, 256, 3)
    assert floor_radiance(sky) == pytest.approx(1.0, rel=1e-5)
    assert sky.max() / sky.mean() < 2 * PEAK


def test_fetching_keeps_panoramas_that_are_there(tmp_path, monkeypatch):
    for name in ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset"):
        (tmp_path / f"{name}.exr").write_bytes(b"")

    def fail(*args, **kwargs):
        raise AssertionError("nothing needs downloading")

    monkeypatch.setattr(panoramas.subprocess, "run", fail)
    assert len(panoramas.fetch(tmp_path)) == 8


def test_external_objects_are_found_measured_and_textured(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="external objects are read by trimesh")
    from spotlight_training.render.external import find_objects, load_object
    from spotlight_training.render.scenes import SceneOptions, describe

    box = trimesh.creation.box(extents=(0.4, 0.8, 0.2))
    (tmp_path / "sub").mkdir()
    box.export(tmp_path / "sub" / "crate.glb")
    sides = find_objects(tmp_path)
    # glTF is y-up: its second side is the height.
    assert sides == {"sub/crate.glb": pytest.approx((0.4, 0.2, 0.8))}
    shape, surfaces = load_object(tmp_path / "sub" / "crate.glb")
    assert {part.slot for part in shape} == {0}
    assert surfaces[0].albedo.shape == (256, 256, 3)
    scenes = [describe("train", s, SceneOptions(file_extents=sides)) for s in range(12)]
    chosen = [s for s in scenes if s.subject.kind == "file:sub/crate.glb"]
    assert 2 <= len(chosen) <= 10
    assert chosen[0].subject.size == pytest.approx(0.8)


def test_a_folder_without_objects_is_named(tmp_path):
    pytest.importorskip("trimesh", reason="external objects are read by trimesh")
    from spotlight_training.render.external import find_objects

    with pytest.raises(FileNotFoundError, match="found none"):
        find_objects(tmp_path)
