"""One service with a tiny backbone for the session, and scenes to send to it."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from support.onnx_backbone import write_backbone
from support.scenes import make_scene, make_shadow

from spotlight_runtime.imaging.images import encode_png

from .servers import Server

EXPECTED = "NumericalError"
"""Of the backbone that overflows; nothing else may go wrong behind an answer's back."""

settings.register_profile(
    "repeatable", deadline=None, database=None, derandomize=True, max_examples=40
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def models(tmp_path_factory):
    """A folder of tiny random backbones of 4 steps, and one of them overflows."""
    folder = tmp_path_factory.mktemp("models")
    write_backbone(folder / "tiny")
    write_backbone(folder / "broken", gain=np.inf)
    return folder


@pytest.fixture(scope="session")
def bundle(tmp_path_factory):
    """A zipped scene of 96×64 pixels."""
    return zipped(tmp_path_factory.mktemp("bundle"))


def zipped(folder: Path, seed: int = 0) -> Path:
    make_scene(64, 96, seed).save(folder / "scene")
    with zipfile.ZipFile(folder / "scene.zip", "w") as archive:
        for path in sorted((folder / "scene").iterdir()):
            archive.write(path, path.name)
    return folder / "scene.zip"


@pytest.fixture(scope="session")
def drawing():
    """A drawn shadow that fits the scene, as PNG bytes."""
    return encode_png(make_shadow(make_scene(64, 96)))


@pytest.fixture(scope="session")
def server(tmp_path_factory, models):
    data = tmp_path_factory.mktemp("service") / "data"
    names = [f"--model={name}" for name in ("tiny", "broken", "mini")]
    running = Server(data, models, *names, requests_per_minute=1_000_000).start()
    yield running
    running.stop()
    log = running.log.read_text()
    assert '"message": "stopped"' in log
    unexpected = [line for line in log.splitlines() if "Traceback" in line and EXPECTED not in line]
    assert not unexpected, unexpected[-1]


@pytest.fixture
def client(server):
    with server.client() as connection:
        yield connection


@pytest.fixture
def scene(client, bundle):
    return client.upload(bundle)
