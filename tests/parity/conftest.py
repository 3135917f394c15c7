"""One tiny random-weight checkpoint, and every way of running it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from oracle.networks import Backbone
from support.checkpoints import Checkpoint, write_tiny_checkpoint
from support.scenes import make_scene

from spotlight_export.export import export_backbone
from spotlight_runtime import Relighter, Scene
from spotlight_spec import BACKBONES, BackboneSpec

from .networks import as_networks
from .trajectories import Trajectories

Over = Callable[[str], Relighter]


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """Tiny tensors are slower on two threads than on one."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Checkpoint:
    return write_tiny_checkpoint(tmp_path_factory.mktemp("checkpoint"))


@pytest.fixture(scope="session")
def backbone64(checkpoint: Checkpoint) -> Backbone:
    return Backbone.load(checkpoint.base, checkpoint.controlnet, torch.float64)


@pytest.fixture(scope="session")
def backbone32(checkpoint: Checkpoint) -> Backbone:
    return Backbone.load(checkpoint.base, checkpoint.controlnet, torch.float32)


@pytest.fixture(scope="session")
def spec() -> BackboneSpec:
    return BACKBONES["zerocomp-openrooms"]


@pytest.fixture(scope="session")
def scene() -> Scene:
    """A ball on a floor, in contact where the floor's depth is roughly affine in the ball's."""
    scene = make_scene()
    behind = scene.background_maps.depth
    contact = 0.5 * behind + 0.3 + 0.05 * np.sin(np.arange(behind.size)).reshape(behind.shape)
    foot = np.where(scene.footprint_depth > 0.0, contact, 0.0).astype(np.float32)
    return replace(scene, footprint_depth=foot)


@pytest.fixture(scope="session")
def onnx_folder(
    checkpoint: Checkpoint, spec: BackboneSpec, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("exported") / spec.name
    export_backbone(spec.name, checkpoint.base, checkpoint.controlnet, folder, report=str, warn=str)
    return folder


@pytest.fixture(scope="session")
def relighter_over(request: pytest.FixtureRequest, spec: BackboneSpec) -> Over:
    """The runtime over the checkpoint's networks, each way made when first asked for.

    ``float64`` and ``torch`` are the torch modules in double and single precision, ``onnx`` the
    exported graphs in ONNX Runtime.
    """

    @cache
    def over(networks: str) -> Relighter:
        if networks == "onnx":
            return Relighter.load(request.getfixturevalue("onnx_folder"), threads=1)
        name = {"float64": "backbone64", "torch": "backbone32"}[networks]
        return Relighter(spec, as_networks(request.getfixturevalue(name)))

    return over


@pytest.fixture(scope="session")
def trajectories(
    spec: BackboneSpec,
    scene: Scene,
    backbone64: Backbone,
    backbone32: Backbone,
    relighter_over: Over,
) -> Trajectories:
    return Trajectories(spec, scene, backbone64, backbone32, relighter_over)
