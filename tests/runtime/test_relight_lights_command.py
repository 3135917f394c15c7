"""``spotlight relight`` by lights, sweeps and previews."""

import json
import warnings

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow
from support.shadow_scenes import ball_scene
from typer.testing import CliRunner

from spotlight_runtime import GuidingShadow, Light, Relighter, Scene, read_image, write_image
from spotlight_runtime.cli import app
from spotlight_runtime.cli.progress import notices
from spotlight_runtime.errors import InvalidInputError, ShadowWarning, SpotLightError
from spotlight_runtime.imaging.colour import srgb_to_linear
from spotlight_runtime.relighting.preview import preview
from spotlight_runtime.relighting.sweep import CAPTION, GAP


@pytest.fixture(scope="module")
def place(tmp_path_factory, backbone):
    folder = tmp_path_factory.mktemp("place")
    scene = make_scene(48, 64)
    scene.save(folder / "ball")
    for side in ("left", "right"):
        shadow = make_shadow(scene, side)
        write_image(folder / f"{side}.png", shadow)
        for i in range(2 if side == "left" else 1):
            write_image(folder / f"ball/shadow_positive_{i:04d}.png", shadow)
    write_image(folder / "ball/shadow_negative_0001.png", make_shadow(scene, "right"))
    (folder / "lights.json").write_text(
        json.dumps([{"shadow": "left.png", "weight": 2}, {"shadow": "right.png"}])
    )
    (folder / "models").mkdir()
    (folder / "models/tiny").symlink_to(backbone)
    return folder


@pytest.fixture
def here(place, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.delenv("SPOTLIGHT_MODELS", raising=False)
    return place


def relight(*extra, scene="ball", output="out.png"):
    arguments = ["relight", scene, "-o", str(output), "--model", "tiny", "--no-denoise"]
    return CliRunner().invoke(app, [*arguments, "--threads", "1", *map(str, extra)])


def done(*extra, **more):
    result = relight(*extra, **more)
    assert result.exit_code == 0, result.output
    return result


@pytest.fixture(scope="module")
def relighter(backbone):
    return Relighter.load(backbone, threads=1, remember=0)


def read_grey(path):
    return read_image(path)


def test_a_ready_light_by_its_name(here, tmp_path, relighter):
    out = tmp_path / "out.exr"
    done("--light", "0001", output=out)
    ready = [read_grey(f"ball/shadow_{kind}_0001.png") for kind in ("positive", "negative")]
    wanted = relighter.relight(Scene.load("ball"), *ready, denoise=False)
    np.testing.assert_array_equal(read_image(out), srgb_to_linear(wanted.image))
    done("--light", "0001", "--negative", "none", output=out)
    wanted = relighter.relight(Scene.load("ball"), ready[0], denoise=False)
    np.testing.assert_array_equal(read_image(out), srgb_to_linear(wanted.image))
    done("--light", "0000", "--negative", "left.png", output=out)
    pair = read_grey("ball/shadow_positive_0000.png"), read_grey("left.png")
    wanted = relighter.relight(Scene.load("ball"), *pair, denoise=False)
    np.testing.assert_array_equal(read_image(out), srgb_to_linear(wanted.image))


def test_a_drawn_negative_is_cleaned_as_a_drawn_shadow(here, tmp_path):
    write_image(tmp_path / "inked.png", 1 - read_grey("right.png"))
    extra = ["--negative", tmp_path / "inked.png", "--invert", "--softness", 1]
    done("--light", "0000", *extra, "--preview", output=tmp_path / "out.png")


def test_an_empty_negative_is_none(here, tmp_path):
    """As that of a light whose opposite casts its shadow where nobody sees it."""
    write_image(tmp_path / "black.png", np.zeros((48, 64), np.float32))
    for name, negative in (("a.png", tmp_path / "black.png"), ("b.png", "none")):
        done("--shadow", "left.png", "--negative", negative, output=tmp_path / name)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), read_image(tmp_path / "b.png"))


def test_a_drawing_of_any_size_among_lights(here, tmp_path):
    drawing = np.zeros((30, 90), np.float32)
    drawing[20:28, 5:40] = 0.8
    write_image(tmp_path / "drawn.png", drawing)
    (tmp_path / "lights.json").write_text('[{"shadow": "drawn.png"}]')
    shadows = []
    for option, name in (("--lights", "lights.json"), ("--shadow", "drawn.png")):
        shadow = tmp_path / f"{name}.exr"
        extra = [option, tmp_path / name, "--preview", "--shadow-out", shadow]
        done(*extra, output=tmp_path / "out.png")
        shadows.append(read_image(shadow))
    np.testing.assert_array_equal(*shadows)


def test_several_lights_from_json(here, tmp_path, relighter):
    out, report, shadow = (tmp_path / name for name in ("out.exr", "report.json", "shadow.exr"))
    done("--lights", "lights.json", "--report", report, "--shadow-out", shadow, output=out)
    guides = [
        GuidingShadow(read_grey("left.png"), weight=2.0),
        GuidingShadow(read_grey("right.png")),
    ]
    wanted = relighter.relight(Scene.load("ball"), guides, denoise=False)
    np.testing.assert_array_equal(read_image(out), srgb_to_linear(wanted.image))
    assert json.loads(report.read_text())["lights"] == 2
    together = (2 * guides[0].positive + guides[1].positive) / 3
    np.testing.assert_allclose(read_image(shadow)[..., 0], together, atol=1e-6)


def test_sweep_of_ready_shadows_is_a_sheet(here, tmp_path, relighter):
    out, report = tmp_path / "sheet.png", tmp_path / "report.json"
    result = done("--sweep", 2, "--report", report, output=out)
    sheet = read_image(out)
    assert sheet.shape == (GAP + 48 + CAPTION + GAP, 2 * (64 + GAP) + GAP, 3)
    assert "2 lights" in result.output
    pictures = json.loads(report.read_text())["pictures"]
    assert [p["light"] for p in pictures] == [f"azimuth {a}°  elevation 45°" for a in (0, 180)]
    assert [p["evaluations"] for p in pictures] == [12, 8]
    guides = [
        GuidingShadow(read_grey("ball/shadow_positive_0000.png")),
        GuidingShadow(
            read_grey("ball/shadow_positive_0001.png"), read_grey("ball/shadow_negative_0001.png")
        ),
    ]
    wanted = relighter.relight_each(Scene.load("ball"), guides, denoise=False)
    for i, each in enumerate(wanted):  # below the inset
        tile = sheet[GAP + 16 : GAP + 48, GAP + i * (64 + GAP) : GAP + i * (64 + GAP) + 64]
        np.testing.assert_allclose(tile, each.image[16:], atol=1 / 255)


def test_animation_of_a_sweep(here, tmp_path):
    pytest.importorskip("PIL", reason="animations need the extra `scene`")
    turn = tmp_path / "turn.gif"
    done("--sweep", 2, "--preview", "--animation", turn, output=tmp_path / "sheet.png")
    assert turn.stat().st_size > 100


def test_preview_needs_no_model(here, tmp_path):
    out, shadow, report = (tmp_path / name for name in ("out.exr", "shadow.png", "report.json"))
    arguments = ["relight", "ball", "--shadow", "left.png", "--preview", "-o", str(out)]
    arguments += ["--model", "none at all", "--shadow-out", str(shadow), "--report", str(report)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    wanted = preview(Scene.load("ball"), read_grey("left.png"))
    np.testing.assert_array_equal(read_image(out), srgb_to_linear(wanted.image))
    np.testing.assert_array_equal(read_image(shadow), read_grey("left.png"))
    assert json.loads(report.read_text())["preview"] is True
    assert "preview" in result.output


def test_a_scribble_of_any_size(here, tmp_path):
    drawing = np.zeros((30, 90), np.float32)
    drawing[20:28, 5:40] = 0.8
    write_image(tmp_path / "drawn.png", drawing)
    write_image(tmp_path / "inked.png", 1 - drawing)
    shadows = []
    for name, extra in (("drawn", []), ("inked", ["--invert", "--softness", 2])):
        out, shadow = tmp_path / f"{name}-out.png", tmp_path / f"{name}-shadow.png"
        arguments = ["--shadow", tmp_path / f"{name}.png", "--shadow-out", shadow, *extra]
        done(*arguments, output=out)
        shadows.append(read_image(shadow))
    assert shadows[0].shape == (48, 64)
    assert shadows[0][38, 16] == 1.0
    np.testing.assert_allclose(shadows[0], shadows[1], atol=0.6)


@pytest.mark.parametrize(
    ("extra", "named"),
    [
        ([], "light: expected one of --azimuth.*got none of them.*--light knows here: 0000, 0001"),
        (["--azimuth", "3", "--shadow", "left.png"], "got --azimuth and --shadow"),
        (["--light", "noon"], "ready shadows here: 0000, 0001"),
        (["--lights", "nowhere.json"], r"nowhere\.json: cannot be read"),
        (["--sweep", "0"], "sweep: expected at least one light"),
        (["--shadow", "left.png", "--negative", "opposite"], "opposite of a ready shadow"),
        (["--shadow", "left.png", "--animation", "a.gif"], "--animation: expected --sweep"),
        (["--sweep", "2", "--animation", "a.avi"], r"a\.avi: expected one of"),
        (["--shadow", "left.png", "--shadow-out", "nowhere/a.png"], "nowhere/a.png: cannot be"),
        (["--azimuth", "3", "--elevation", "95"], "elevation: expected a finite number"),
        (["--azimuth", "3", "--radius", "-1"], "radius: expected a finite number"),
        (["--azimuth", "3", "--distance", "0"], "distance: expected a finite number above 0"),
        (["--light", "0000", "--elevation", "70"], "--elevation: expected --azimuth or --sweep"),
        (["--shadow", "left.png", "--elevation", "20"], "--elevation: .*got --shadow; leave one"),
        (["--shadow", "left.png", "--directional"], "--directional: expected --azimuth or"),
        (["--lights", "lights.json", "--radius", "0"], "--radius: .*got --lights"),
        (["--lights", "lights.json", "--distance", "5"], "--distance: .*got --lights"),
        (["--azimuth", "10", "--softness", "5"], "--softness: expected --shadow or a drawn --neg"),
        (["--azimuth", "10", "--negative", "none", "--invert"], "--invert: expected --shadow"),
        (["--azimuth", "1", "--directional", "--distance", "3"], "--distance: expected none"),
    ],
)
def test_what_does_not_go_together_is_named(here, extra, named):
    result = relight(*extra)
    assert isinstance(result.exception, SpotLightError), result.output
    with pytest.raises(
        InvalidInputError if "cannot be" not in named else SpotLightError, match=named
    ):
        raise result.exception


@pytest.fixture(scope="module")
def cast(tmp_path_factory, backbone):
    """A place with a scene that casts."""
    pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")
    folder = tmp_path_factory.mktemp("cast")
    scene = ball_scene(64)
    normal = np.zeros((64, 64, 3), np.float32)
    normal[..., 2] = scene.object_mask
    maps = type(scene.object_maps)(scene.object_maps.albedo, normal, scene.object_maps.depth)
    Scene(
        **{
            name: getattr(scene, name)
            for name in Scene.__dataclass_fields__
            if name != "object_maps"
        },
        object_maps=maps,
    ).save(folder / "scene")
    (folder / "models").mkdir()
    (folder / "models/tiny").symlink_to(backbone)
    return folder


@pytest.mark.parametrize(
    ("extra", "light"),
    [
        ([], Light(azimuth=20.0, elevation=45.0)),
        (["--elevation", 30, "--radius", 0], Light(azimuth=20.0, elevation=30.0, radius=0.0)),
        (["--distance", 3], Light(azimuth=20.0, elevation=45.0, distance=3.0)),
        (
            ["--directional", "--radius", 0.3],
            Light(azimuth=20.0, elevation=45.0, radius=0.3, distance=None),
        ),
    ],
)
def test_light_by_its_place(cast, tmp_path, monkeypatch, relighter, extra, light):
    monkeypatch.chdir(cast)
    out = tmp_path / "out.exr"
    done("--azimuth", 20, *extra, scene="scene", output=out)
    wanted = relighter.relight(Scene.load("scene"), light, denoise=False)
    np.testing.assert_array_equal(read_image(out), srgb_to_linear(wanted.image))


def test_negative_of_a_light(cast, tmp_path, monkeypatch, relighter):
    monkeypatch.chdir(cast)
    scene, light = Scene.load("scene"), Light(azimuth=20.0, elevation=45.0)
    write_image(tmp_path / "drawn.png", np.eye(64, dtype=np.float32))
    for negative in ("none", "opposite", str(tmp_path / "drawn.png")):
        out = tmp_path / "out.exr"
        done("--azimuth", 20, "--negative", negative, scene="scene", output=out)
        given = read_image(negative) if negative.endswith("png") else negative
        wanted = relighter.relight(scene, light, given, denoise=False)
        np.testing.assert_array_equal(read_image(out), srgb_to_linear(wanted.image))


def test_sweep_casts_where_no_shadows_lie_ready(cast, tmp_path, monkeypatch):
    monkeypatch.chdir(cast)
    out = tmp_path / "sheet.png"
    result = done("--sweep", 3, "--elevation", 50, "--preview", scene="scene", output=out)
    assert "3 lights" in result.output
    assert read_image(out).shape[1] == 3 * (64 + GAP) + GAP


def test_notices_are_one_line_on_stderr(capsys):
    with notices():
        warnings.warn("the shadow falls\n behind the camera", ShadowWarning, stacklevel=1)
        warnings.warn("the shadow falls\n behind the camera", ShadowWarning, stacklevel=1)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == 2 * "spotlight: note: the shadow falls behind the camera\n"


def said_among_notices():
    with notices():
        warnings.simplefilter("always")
        warnings.warn("something else", UserWarning, stacklevel=1)


def test_other_warnings_stay_what_they_are():
    with pytest.warns(UserWarning, match="something else"):
        said_among_notices()
