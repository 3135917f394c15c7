"""One tiny backbone for the session; everything else is made by the test that needs it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from support.onnx_backbone import write_backbone
from support.scenes import make_scene, make_shadow

from spotlight_runtime import Relighter, RelightOptions

settings.register_profile(
    "repeatable", deadline=None, database=None, derandomize=True, max_examples=40
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def backbone(tmp_path_factory):
    """Model folder of a tiny random backbone with 4 steps."""
    return write_backbone(tmp_path_factory.mktemp("models") / "tiny")


@pytest.fixture(scope="session")
def relighter(backbone):
    return Relighter.load(backbone, threads=1, remember=0)


@pytest.fixture
def options():
    """As a person runs it, but for the denoiser, which has tests of its own."""
    return RelightOptions(denoise=False)


@pytest.fixture(scope="session")
def scene():
    return make_scene(64, 96)


@pytest.fixture(scope="session")
def shadow(scene):
    return make_shadow(scene, "left")


@pytest.fixture(scope="session")
def negative(scene):
    return make_shadow(scene, "right")


@pytest.fixture
def rng():
    return np.random.default_rng(7)
