"""The README's commands and code run as written."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow

from spotlight_runtime import Scene, write_image
from spotlight_runtime.imaging.colour import linear_to_srgb

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
SKIPPED = ("make ", "pip ")  # make test runs this test; the edge target installs the wheel


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A folder with what the README says is there."""
    checkpoints = pytest.importorskip("support.checkpoints", reason="needs the export extra")
    trimesh = pytest.importorskip("trimesh", reason="needs the scene extra")
    folder = tmp_path_factory.mktemp("readme")
    checkpoint = checkpoints.write_tiny_checkpoint(folder / "checkpoint")
    Path(checkpoint.base).rename(folder / "sd21")
    Path(checkpoint.controlnet).rename(folder / "zerocomp")
    room = Scene.load(ROOT / "runtime/spotlight_runtime/demo/bench").background
    write_image(folder / "room.jpg", linear_to_srgb(np.clip(room, 0.0, 1.0)))
    trimesh.creation.box((0.5, 0.9, 0.5)).export(folder / "chair.glb")
    write_image(folder / "scribble.png", make_shadow(make_scene(256, 256)))
    lights = [{"azimuth": 30, "elevation": 50}, {"azimuth": 200, "elevation": 40}]
    (folder / "lights.json").write_text(json.dumps(lights))
    return folder


def test_commands(house):
    commands = [
        line.split("  #")[0].strip()
        for block in blocks("sh")
        for line in block.splitlines()
        if line.strip() and not line.startswith(SKIPPED)
    ]
    assert [" ".join(shlex.split(c)[:2]) for c in commands] == [
        "spotlight compose",
        "spotlight relight",
        "spotlight relight",
        "spotlight relight",
        "spotlight relight",
        "spotlight relight",
        "spotlight shadow",
        "spotlight plan",
        "spotlight relight",
        "spotlight relight",
        "spotlight-export zerocomp-openrooms",
        "spotlight-export verify",
        "spotlight models",
    ]
    for command in commands:
        program, *arguments = shlex.split(command)
        done = subprocess.run(
            [Path(sys.executable).parent / program, *arguments],
            cwd=house,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        if "-o" in arguments:
            assert (house / arguments[arguments.index("-o") + 1]).exists(), command
    assert json.loads((house / "report.json").read_text())["evaluations"] == 60


def test_python(house):
    (code,) = blocks("python")
    (house / "out.png").unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=house, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (house / "out.png").is_file()


def test_files_that_are_linked_are_there():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if "://" not in target:
            assert (ROOT / target).is_file(), target
