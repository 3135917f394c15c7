"""Backbones small enough for hundreds of whole relights."""

from __future__ import annotations

import pytest
from support.onnx_backbone import tiny_spec, write_backbone

from properties.equivariant import equivariant_networks
from spotlight_runtime import Relighter


@pytest.fixture(scope="session")
def onnx_relighter(tmp_path_factory):
    """Random convolutions, opened by ONNX Runtime as any model is."""
    folder = write_backbone(tmp_path_factory.mktemp("models") / "tiny", tiny_spec(steps=3))
    return Relighter.load(folder, threads=1, remember=0)


@pytest.fixture(scope="session")
def mirror_relighter():
    """The networks that know no left and right."""
    spec = tiny_spec(steps=4)
    return Relighter(spec, equivariant_networks(spec), remember=0)


@pytest.fixture(scope="session")
def shadeless_relighter():
    """The same, blind to how bright the photograph is."""
    spec = tiny_spec(steps=3)
    return Relighter(spec, equivariant_networks(spec, blind_to="shading"), remember=0)
