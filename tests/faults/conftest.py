"""A backbone and a scene on disk, as a command line takes them."""

from __future__ import annotations

import pytest
from support.onnx_backbone import tiny_spec, write_backbone
from support.scenes import make_scene, make_shadow

from spotlight_runtime import write_image


@pytest.fixture(scope="session")
def backbone(tmp_path_factory):
    return write_backbone(tmp_path_factory.mktemp("models") / "tiny", tiny_spec(steps=3))


@pytest.fixture(scope="session")
def place(tmp_path_factory):
    """Folder with ``scene`` and ``shadow.png``."""
    folder = tmp_path_factory.mktemp("place")
    scene = make_scene(48, 64)
    scene.save(folder / "scene")
    write_image(folder / "shadow.png", make_shadow(scene))
    return folder


@pytest.fixture
def asked(place, backbone):
    """Arguments of a relight, but for its output."""
    options = ["--model", backbone, "--no-denoise", "--threads", "1"]
    return ["relight", place / "scene", "--shadow", place / "shadow.png", *options]
