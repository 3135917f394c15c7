"""The scenes that come along load, and the demo relights one from all round."""

import sys

import pytest

from spotlight_runtime import Scene, read_image
from spotlight_runtime.cli import main
from spotlight_runtime.cli.demo import SCENES, find_scene
from spotlight_runtime.errors import InvalidInputError

NAMES = ("bench", "berries", "goblet")


@pytest.mark.parametrize("name", NAMES)
def test_scene_is_whole(name):
    scene = Scene.load(SCENES / name)
    assert scene.name == name
    assert scene.size == (256, 256)
    assert scene.object_mesh is not None
    assert scene.ground is not None


def test_no_other_scene_comes_along():
    assert tuple(sorted(path.name for path in SCENES.iterdir())) == NAMES


def test_first_scene_is_the_default():
    assert find_scene(None).name == NAMES[0]


def test_unknown_scene_is_answered_with_those_there_are():
    with pytest.raises(InvalidInputError, match="bench, berries, goblet"):
        find_scene("sofa")


def test_demo_writes_a_sheet(backbone, tmp_path, monkeypatch):
    pytest.importorskip("embreex", reason="casting shadows needs the scene extra")
    sheet = tmp_path / "sheet.png"
    arguments = ["demo", "-o", sheet, "--model", backbone, "--steps", "1", "--lights", "2"]
    monkeypatch.setattr(sys, "argv", ["spotlight", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    pixels = read_image(sheet)
    assert pixels.shape[1] > 2 * 256
    assert pixels.std() > 0.05
