"""The README's commands and code run as written."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.scenes import make_scene, make_shadow

from spotlight_runtime import write_image

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
SKIPPED = ("make ", "pip ")  # make test runs this test; the edge target installs the wheel


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A folder with what the README says is there."""
    checkpoints = pytest.importorskip("support.checkpoints", reason="needs the export extra")
    folder = tmp_path_factory.mktemp("readme")
    checkpoint = checkpoints.write_tiny_checkpoint(folder / "checkpoint")
    Path(checkpoint.base).rename(folder / "sd21")
    Path(checkpoint.controlnet).rename(folder / "zerocomp")
    scene = make_scene()
    scene.save(folder / "chair")
    write_image(folder / "left.png", make_shadow(scene))
    write_image(folder / "right.png", make_shadow(scene, "right"))
    return folder


def test_commands(house):
    commands = [
        line.split("  #")[0].strip()
        for block in blocks("sh")
        for line in block.splitlines()
        if line.strip() and not line.startswith(SKIPPED)
    ]
    assert [shlex.split(c)[0] for c in commands] == [
        "spotlight-export",
        "spotlight-export",
        "spotlight",
        "spotlight",
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
    assert (house / "out.png").is_file()
    assert (house / "report.json").is_file()


def test_python(house):
    (code,) = blocks("python")
    (house / "out.png").unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=house, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (house / "out.png").is_file()
