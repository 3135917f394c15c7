"""The ``spotlight`` command as a person or a script runs it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.onnx_backbone import write_backbone
from support.scenes import make_scene, make_shadow
from typer.testing import CliRunner

from spotlight_runtime import Relighter, RelightOptions, Scene, read_image, write_image
from spotlight_runtime.cli import app, main
from spotlight_runtime.errors import SpotLightError
from spotlight_runtime.imaging.colour import linear_to_srgb, srgb_to_linear
from spotlight_runtime.imaging.images import write_exr_layers


@pytest.fixture(scope="module")
def place(tmp_path_factory, backbone):
    """A folder with a scene, two shadows and a model, as after `spotlight-export`."""
    folder = tmp_path_factory.mktemp("place")
    scene = make_scene(24, 32)
    scene.save(folder / "ball")
    for side in ("left", "right"):
        write_image(folder / f"{side}.png", make_shadow(scene, side))
    (folder / "models").mkdir()
    (folder / "models/tiny").symlink_to(backbone)
    return folder


@pytest.fixture
def here(place, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.delenv("SPOTLIGHT_MODELS", raising=False)
    return place


def relight(*extra, scene="ball", shadow="left.png", output="out.png", model="tiny"):
    """Run in this process; errors of the package come out as they are, `main` prints them."""
    arguments = ["relight", scene, "--shadow", shadow, "-o", str(output), "--model", model]
    arguments += ["--no-denoise", "--threads", "1", *map(str, extra)]
    return CliRunner().invoke(app, arguments)


def spotlight(*arguments, cwd):
    """The installed command in a process of its own."""
    command = [sys.executable, "-c", "from spotlight_runtime.cli import main; main()", *arguments]
    environment = {k: v for k, v in os.environ.items() if k != "SPOTLIGHT_MODELS"}
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


def expected(here, negative=None, **options):
    relighter = Relighter.load(here / "models/tiny", threads=1)
    shadows = [read_image(here / f"{side}.png") if side else None for side in ("left", negative)]
    options = RelightOptions(denoise=False, **options)
    return relighter.relight(Scene.load(here / "ball"), *shadows, options).image


@pytest.mark.parametrize("negative", [None, "right"])
def test_writes_the_picture_the_library_makes(here, tmp_path, negative):
    out = tmp_path / "out.exr"
    extra = ["--negative", f"{negative}.png"] if negative else []
    done = relight(*extra, output=out)
    assert done.exit_code == 0, done.output
    np.testing.assert_array_equal(read_image(out), srgb_to_linear(expected(here, negative)))


def test_negative_none_is_the_default(here, tmp_path):
    for name, extra in (("a", []), ("b", ["--negative", "none"])):
        assert relight(*extra, output=tmp_path / f"{name}.png").exit_code == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_every_option_reaches_the_relighter(here, tmp_path):
    report = tmp_path / "report.json"
    done = relight(
        *("--gamma", "5", "--beta", "0.2", "--seed", "0", "--steps", "2", "--solver", "unipc"),
        *("--plain-steps", "1", "--guided", "0.5", "1", "--reuse", "2"),
        *("--fidelity", "release", "--report", report),
        output=tmp_path / "out.exr",
    )
    assert done.exit_code == 0, done.output
    options = {
        "gamma": 5.0,
        "beta": 0.2,
        "seed": 0,
        "steps": 2,
        "solver": "unipc",
        "plain_steps": 1,
        "guidance_interval": [0.5, 1.0],
        "reuse": 2,
        "fidelity": "release",
    }
    written = json.loads(report.read_text())
    assert written["options"].items() >= options.items()
    wanted = srgb_to_linear(expected(here, **options))
    np.testing.assert_array_equal(read_image(tmp_path / "out.exr"), wanted)


def test_report_names_scene_output_model_and_costs(here, tmp_path):
    report = tmp_path / "report.json"
    assert relight("--report", report, output=tmp_path / "out.png").exit_code == 0
    written = json.loads(report.read_text())
    assert written["scene"] == "ball"
    assert written["output"] == str(tmp_path / "out.png")
    assert written["model"]["backbone"] == "zerocomp-openrooms"
    assert written["size"] == {"width": 32, "height": 24}
    assert written["evaluations"] == 12
    assert written["peak_memory_bytes"] > 1e6
    assert sum(written["seconds"].values()) > 0.0


def test_low_memory_gives_the_same_picture(here, tmp_path):
    assert relight("--low-memory", output=tmp_path / "a.exr").exit_code == 0
    got = read_image(tmp_path / "a.exr")
    np.testing.assert_allclose(got, srgb_to_linear(expected(here)), atol=1e-5)


@pytest.mark.parametrize("preview", [[], ["--preview"]])
def test_linear_light_is_the_png_within_its_rounding(here, tmp_path, preview):
    for name in ("out.exr", "out.hdr", "out.png"):
        assert relight(*preview, output=tmp_path / name).exit_code == 0
    encoded = read_image(tmp_path / "out.png")
    linear = read_image(tmp_path / "out.exr")
    np.testing.assert_allclose(linear_to_srgb(linear), encoded, atol=0.5 / 255 + 1e-6)
    # Radiance shares eight bits among the channels of a pixel.
    np.testing.assert_allclose(read_image(tmp_path / "out.hdr"), linear, atol=1 / 128)


@pytest.mark.parametrize("name", ["out.png", "out.jpg", "out.webp", "out.exr", "a[/b].png"])
def test_any_format_under_any_name(here, tmp_path, name):
    """Also one that the table printer would take for markup."""
    out = tmp_path / name
    out.parent.mkdir(exist_ok=True)
    done = relight(output=out)
    assert done.exit_code == 0, done.output
    assert f"{out}: exact plan, 12 evaluations" in done.output
    assert read_image(out).shape == (24, 32, 3)


@pytest.mark.parametrize("form", ["16-bit", "colour", "with alpha", "one channel and alpha"])
def test_shadow_in_any_form(here, tmp_path, form):
    grey = read_image(here / "left.png")
    path = tmp_path / "shadow.png"
    if form == "16-bit":
        write_image(path, grey, bits=16)
    elif form == "colour":
        write_image(path, np.repeat(grey[..., None], 3, axis=-1))
    elif form == "with alpha":
        write_image(path, np.dstack([grey, grey, grey, np.ones_like(grey)]))
    else:
        path = tmp_path / "shadow.exr"
        write_exr_layers(path, {"": np.dstack([grey, np.ones_like(grey)])})
    done = relight(shadow=str(path), output=tmp_path / "out.exr")
    assert done.exit_code == 0, done.output
    wanted = srgb_to_linear(expected(here))
    np.testing.assert_allclose(read_image(tmp_path / "out.exr"), wanted, atol=1e-4)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"scene": "nowhere"}, "nowhere: no scene here"),
        ({"scene": "left.png"}, r"left\.png: no scene here"),
        ({"shadow": "nowhere.png"}, r"nowhere\.png"),
        ({"shadow": "ball/background.exr", "scene": "models"}, "models: no scene here"),
        ({"model": "nope"}, "model 'nope'.*tiny"),
        ({"output": "nowhere/out.png"}, "nowhere/out.png: cannot be written"),
        ({"output": "out.gif"}, r"out\.gif: expected one of"),
        ({"output": "out"}, "out: expected one of"),
    ],
)
def test_bad_input_is_an_error_that_names_it(here, changed, named):
    done = relight(**changed)
    assert isinstance(done.exception, SpotLightError)
    assert done.exit_code == 1
    with pytest.raises(SpotLightError, match=named):
        raise done.exception


@pytest.mark.parametrize(
    ("extra", "named"),
    [
        (["--negative", "nowhere.png"], r"nowhere\.png"),
        (["--gamma", "21"], "gamma"),
        (["--beta", "nan"], "beta"),
        (["--seed", "-1"], "seed"),
        (["--seed", str(2**63)], "seed"),
        (["--steps", "0"], "steps"),
        (["--steps", "1001"], "steps"),
        (["--threads", "0"], "threads"),
    ],
)
def test_bad_option_is_an_error_that_names_it(here, extra, named):
    done = relight(*extra)
    assert isinstance(done.exception, SpotLightError)
    with pytest.raises(SpotLightError, match=named):
        raise done.exception


@pytest.mark.parametrize(
    "extra", [["--steps", "two"], ["--solver", "euler"], ["--fidelity", "exact"], ["--colour", "x"]]
)
def test_what_typer_refuses_is_a_usage_error(here, extra):
    done = relight(*extra)
    assert done.exit_code == 2
    assert extra[0].lstrip("-") in done.output


def test_process_relights_and_prints_one_summary(place, tmp_path):
    out, report = tmp_path / "out.png", tmp_path / "report.json"
    done = spotlight(
        *("relight", "ball", "--shadow", "left.png", "--negative", "right.png", "-o", str(out)),
        *("--model", "tiny", "--no-denoise", "--threads", "1", "--report", str(report)),
        cwd=place,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert f"{out}: exact plan, 12 evaluations, " in done.stderr
    assert read_image(out).shape == (24, 32, 3)
    assert json.loads(report.read_text())["evaluations"] == 12


def truncated(path, keep=0.7):
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])


@pytest.mark.parametrize("case", ["no scene", "truncated exr", "truncated png", "damaged model"])
def test_error_is_one_line_on_stderr_and_exit_code_1(place, tmp_path, case):
    scene, model = tmp_path / "ball", tmp_path / "model"
    make_scene(24, 32).save(scene)
    write_backbone(model)
    if case == "no scene":
        (scene / "scene.json").unlink()
    elif case == "truncated exr":
        truncated(scene / "background.exr")
    elif case == "truncated png":
        truncated(scene / "object_mask.png")
    else:
        truncated(model / "denoiser.onnx")
    arguments = ["relight", str(scene), "--shadow", "left.png", "-o", str(tmp_path / "out.png")]
    done = spotlight(*arguments, "--model", str(model), cwd=place)
    assert done.returncode == 1
    lines = done.stderr.strip().splitlines()
    assert lines[-1].startswith("spotlight: ")
    assert "Traceback" not in done.stderr
    if not case.startswith("truncated"):  # there the decoder's library says a word of its own
        assert len(lines) == 1
        assert done.stdout == ""
    assert not (tmp_path / "out.png").exists()


def test_main_prints_what_a_command_raises(here, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["spotlight", "relight", "x", "--shadow", "y", "-o", "z.png"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("spotlight: x: no scene here")
    assert printed.err.count("\n") == 1


def test_broken_network_is_one_line_too(place, tmp_path):
    model = write_backbone(tmp_path / "broken", gain=np.inf)
    arguments = ["relight", "ball", "--shadow", "left.png", "-o", str(tmp_path / "out.png")]
    done = spotlight(*arguments, "--model", str(model), "--no-denoise", cwd=place)
    assert done.returncode == 1
    errors = [line for line in done.stderr.splitlines() if "NaN or infinite" in line]
    assert len(errors) == 1
    assert errors[0].startswith("spotlight: pass 'relight', step 0 (timestep 999)")
    assert "Warning" not in done.stderr


@pytest.mark.parametrize(
    ("target", "said"),
    [("nowhere/report.json", "there is no folder nowhere"), ("ball", "it is a folder")],
)
def test_report_that_cannot_be_written_is_one_line_before_the_relight(
    place, tmp_path, target, said
):
    out = tmp_path / "out.png"
    arguments = ["relight", "ball", "--shadow", "left.png", "-o", str(out), "--model", "tiny"]
    done = spotlight(*arguments, "--no-denoise", "--report", target, cwd=place)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert done.stderr.strip().splitlines()[-1].startswith("spotlight: ")
    assert f"{target}: cannot be written: {said}" in done.stderr
    assert not out.exists()
    assert not list(place.glob("*.partial*"))


@pytest.mark.parametrize("output", ["out.gif", "nowhere/out.png", "folder.png"])
def test_output_is_checked_before_anything_is_loaded(here, output):
    (here / "folder.png").mkdir(exist_ok=True)
    done = relight(output=output, scene="no scene", model="no model")
    with pytest.raises(SpotLightError, match=output):
        raise done.exception


@pytest.mark.parametrize("arguments", [["--help"], ["relight", "--help"], ["models", "--help"]])
def test_help_says_what_to_type(arguments):
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0
    assert "spotlight" in done.output or arguments[0] == "models"


def test_help_of_relight_has_an_example():
    done = CliRunner().invoke(app, ["relight", "--help"], env={"COLUMNS": "200"})
    assert "spotlight relight chair/ --shadow left.png --negative right.png" in done.output


def test_no_arguments_is_the_help():
    done = CliRunner().invoke(app, [])
    assert "relight" in done.output
    assert "models" in done.output


def test_models_for_people(here):
    done = CliRunner().invoke(app, ["models"], env={"COLUMNS": "200"})
    assert done.exit_code == 0
    assert "tiny" in done.output
    assert "zerocomp-openrooms" in done.output
    assert "not verified" in done.output


def test_models_for_machines(here):
    done = CliRunner().invoke(app, ["models", "--json"])
    (model,) = [m for m in json.loads(done.output) if m["name"] == "tiny"]
    assert model["precision"] == "fp32"
    assert model["layout"] == "fused"


def test_no_models_says_how_to_get_one(tmp_path):
    done = spotlight("models", "--json", cwd=tmp_path)
    assert done.returncode == 0
    embedded = json.loads(done.stdout)
    done = spotlight("models", cwd=tmp_path)
    assert done.returncode == 0
    if not embedded:
        assert "spotlight-export" in done.stderr
        assert "SPOTLIGHT_MODELS" in done.stderr


def test_installed_script_is_the_same_command(place):
    script = Path(sys.executable).with_name("spotlight")
    if not script.exists():
        pytest.skip("the console script is not installed beside this python")
    done = subprocess.run([script, "models", "--json"], cwd=place, capture_output=True, check=True)
    assert "tiny" in [model["name"] for model in json.loads(done.stdout)]
