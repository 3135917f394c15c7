"""One tiny backbone and one tiny test set for the session."""

from __future__ import annotations

import pytest

pytest.importorskip("skimage", reason="needs the bench extra")

from support.onnx_backbone import tiny_spec, write_backbone

from bench.published import write_set


@pytest.fixture(scope="session")
def backbone_folder(tmp_path_factory):
    """Model folder of a tiny random backbone with 2 steps."""
    return write_backbone(tmp_path_factory.mktemp("models") / "tiny", tiny_spec(steps=2))


@pytest.fixture(scope="session")
def testset(tmp_path_factory):
    """Two scenes of 64×64 pixels with truths."""
    return write_set(tmp_path_factory.mktemp("data") / "testset")


@pytest.fixture(scope="session")
def scene_folder(testset):
    return testset / "room_0"
