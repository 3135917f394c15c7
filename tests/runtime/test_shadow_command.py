"""``spotlight shadow``, as typed."""

import importlib.util
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from support import shadow_scenes as known
from support.scenes import make_scene
from typer.testing import CliRunner

from spotlight_runtime import read_image, write_image
from spotlight_runtime.cli import app
from spotlight_runtime.errors import SpotLightError

ray_casting = pytest.mark.skipif(
    importlib.util.find_spec("embreex") is None,
    reason="casting shadows needs the extra `scene`",
)


def shadow(*arguments):
    """Run in this process; errors of the package come out as they are, `main` prints them."""
    return CliRunner().invoke(app, ["shadow", *map(str, arguments)])


def spotlight(*arguments):
    """The installed command in a process of its own."""
    script = "from spotlight_runtime.cli import main; main()"
    command = [sys.executable, "-c", script, "shadow", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes") / "ball"
    known.ball_scene(64).save(folder)
    return folder


@ray_casting
def test_a_light_and_its_opposite(bundle, tmp_path):
    out, negative = tmp_path / "left.png", tmp_path / "right.png"
    done = shadow(
        bundle,
        "--azimuth",
        135,
        "--elevation",
        40,
        "--radius",
        0.3,
        "-o",
        out,
        "--negative",
        negative,
    )
    assert done.exit_code == 0, done.stderr
    assert "of the picture dark" in done.stderr
    left, right = read_image(out), read_image(negative)
    assert left.shape == right.shape == (64, 64)
    columns = np.arange(64)
    assert (left.sum(0) @ columns) / left.sum() > 34  # the light is on the left, the shadow right
    assert (right.sum(0) @ columns) / right.sum() < 30
    assert np.abs(left - right).max() > 0.9


@ray_casting
@pytest.mark.parametrize(
    "arguments",
    [
        ("--azimuth", 150, "--elevation", 30, "--directional", "--radius", 0.27),
        ("--azimuth", 150, "--elevation", 60, "--frame", "camera", "--distance", 4, "--radius", 0),
        ("--light-position=-2,1,2.5", "--radius", 0.2, "--samples", 8),
    ],
)
def test_every_kind_of_light(bundle, tmp_path, arguments):
    done = shadow(bundle, *arguments, "-o", tmp_path / "s.png")
    assert done.exit_code == 0, done.stderr
    assert (read_image(tmp_path / "s.png") > 0.9).sum() > 50


@ray_casting
def test_an_unseen_shadow_is_noted(bundle, tmp_path):
    light = ("--azimuth", 270, "--elevation", 24, "--radius", 0.1)
    done = shadow(bundle, *light, "-o", tmp_path / "s.png")
    assert done.exit_code == 0
    assert "spotlight: note: the object hides its own shadow" in done.stderr


def test_a_scribble_is_cleaned(tmp_path):
    make_scene(48, 64).save(tmp_path / "scene")
    drawing = np.zeros((96, 128, 3), np.float32)
    drawing[70:80, 10:60] = 0.8
    write_image(tmp_path / "drawing.jpg", drawing)
    out = tmp_path / "s.png"
    done = shadow(
        tmp_path / "scene", "--scribble", tmp_path / "drawing.jpg", "--softness", 3, "-o", out
    )
    assert done.exit_code == 0, done.stderr
    cleaned = read_image(out)
    assert cleaned.shape == (48, 64)
    assert cleaned[37, 8:25].min() > 0.6
    assert not cleaned[:20].any()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "expected azimuth and elevation"),
        (("--azimuth", 10), "elevation None"),
        (("--azimuth", 10, "--elevation", 100), "elevation: expected a finite number"),
        (("--light-position", "1,2"), "--light-position: expected three numbers"),
        (("--light-position", "a,b,c"), "three numbers"),
        (("--azimuth", 1, "--elevation", 9, "--light-position", "1,2,3"), "got both"),
        (("--azimuth", 1, "--elevation", 9, "--scribble", "d.png"), "leave one out"),
        (("--scribble", "d.png", "--negative", "n.png"), "draw a second one"),
        (("--scribble", "missing.png"), "missing.png"),
        (("--azimuth", 1, "--elevation", 9, "--negative", "n.txt"), "n.txt"),
    ],
)
def test_mistakes_are_named(bundle, tmp_path, arguments, said):
    done = shadow(bundle, *arguments, "-o", tmp_path / "s.png")
    assert isinstance(done.exception, SpotLightError)
    assert said in str(done.exception)
    assert not (tmp_path / "s.png").exists()


@ray_casting
def test_an_impossible_light_is_one_line(bundle, tmp_path):
    done = spotlight(bundle, "--azimuth", 10, "--elevation", -30, "-o", tmp_path / "s.png")
    assert done.returncode == 1
    assert done.stderr.startswith("spotlight: ")
    assert done.stderr.count("\n") == 1
    assert "raise its elevation" in done.stderr


def test_help_teaches():
    done = shadow("--help")
    assert done.exit_code == 0
    for word in ("--azimuth", "180 left", "--directional", "spotlight shadow chair/", "--scribble"):
        assert word in done.stdout


@ray_casting
def test_a_published_scene_casts_from_a_relief(tmp_path):
    """No mesh in the bundle: mask, depth and footprint are all there is."""
    scene = replace(known.ball_scene(64), object_mesh=None, ground=None)
    scene.save(tmp_path / "flat")
    done = shadow(tmp_path / "flat", "--azimuth", 135, "--elevation", 40, "-o", tmp_path / "s.png")
    assert done.exit_code == 0, done.stderr
    assert (read_image(tmp_path / "s.png") > 0.5).sum() > 100
