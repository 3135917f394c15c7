"""One tiny checkpoint and one export of it for the whole suite: tracing is what takes time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from support.checkpoints import Checkpoint, write_tiny_checkpoint

from spotlight_export.convert import convert_model
from spotlight_export.export import export_backbone


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
def models(checkpoint: Checkpoint, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the models that the other fixtures name."""
    return tmp_path_factory.mktemp("models")


@pytest.fixture(scope="session")
def fused(checkpoint: Checkpoint, models: Path) -> Path:
    export_backbone("zerocomp", checkpoint.base, checkpoint.controlnet, models / "fused")
    return models / "fused"


@pytest.fixture(scope="session")
def split(checkpoint: Checkpoint, models: Path) -> Path:
    export_backbone(
        "zerocomp", checkpoint.base, checkpoint.controlnet, models / "split", layout="split"
    )
    return models / "split"


@pytest.fixture(scope="session")
def half(fused: Path, models: Path) -> Path:
    convert_model(fused, models / "half", "fp16")
    return models / "half"


@pytest.fixture(scope="session")
def int8(fused: Path, models: Path) -> Path:
    convert_model(fused, models / "int8", "int8")
    return models / "int8"


@pytest.fixture(scope="session")
def split_int8(split: Path, models: Path) -> Path:
    convert_model(split, models / "split-int8", "int8")
    return models / "split-int8"
