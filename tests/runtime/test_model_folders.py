"""Finding models, checking them, opening their graphs."""

import json
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from support.onnx_backbone import tiny_spec, write_backbone

from spotlight_runtime import Relighter
from spotlight_runtime.errors import (
    InvalidInputError,
    ModelError,
    ModelIntegrityError,
    ProviderError,
    UnknownModelError,
)
from spotlight_runtime.networks.models import (
    LazyNetworks,
    find_models,
    open_networks,
    resolve_model,
)
from spotlight_spec import MANIFEST_NAME, Manifest, ParityRow, Source, write_json


@pytest.fixture
def no_models(tmp_path, monkeypatch):
    """A working directory and search path without models."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SPOTLIGHT_MODELS", raising=False)
    return tmp_path


@pytest.fixture
def copied(backbone, no_models):
    """A copy of the tiny backbone that a test may spoil."""
    return shutil.copytree(backbone, no_models / "models/tiny")


def names():
    return [model.path.name for model in find_models() if model.path.parent.name != "backbones"]


def test_models_of_the_working_directory(copied):
    assert names() == ["tiny"]
    assert resolve_model("tiny").path.name == "tiny"


def test_search_path_comes_first_in_its_order(backbone, no_models, monkeypatch):
    for root in ("a", "b", "models"):
        shutil.copytree(backbone, no_models / root / f"in-{root}")
        shutil.copytree(backbone, no_models / root / "same")
    monkeypatch.setenv("SPOTLIGHT_MODELS", os.pathsep.join(["b", "", "a", "nowhere"]))
    assert names() == ["in-b", "same", "in-a", "same", "in-models", "same"]
    assert resolve_model("same").path.parent.name == "b"


def test_model_is_found_by_folder_by_name_and_by_backbone(copied):
    for model in (copied, str(copied), "tiny", "zerocomp-openrooms"):
        assert resolve_model(model).path.samefile(copied)


@pytest.mark.parametrize("model", ["nope", "", "nope/tiny", "x" * 5000, "a\0b"])
def test_unknown_model_names_the_known_ones(copied, model):
    with pytest.raises(UnknownModelError, match=r"there are here: .*tiny") as caught:
        resolve_model(model)
    assert "SPOTLIGHT_MODELS" in str(caught.value)
    assert isinstance(caught.value, LookupError)


def test_folder_without_manifest_is_unknown(no_models):
    (no_models / "empty").mkdir()
    with pytest.raises(UnknownModelError, match=r"expected a folder with manifest\.json"):
        resolve_model(no_models / "empty")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 1}', "\udcff"])
def test_malformed_manifest_is_named_and_left_out_of_the_list(copied, text):
    (copied / MANIFEST_NAME).write_text(text, errors="surrogateescape")
    assert names() == []
    with pytest.raises(ModelIntegrityError, match=r"manifest\.json.*export the model again"):
        resolve_model(copied)


@pytest.mark.parametrize("spoil", ["missing", "truncated", "flipped", "grown"])
@pytest.mark.parametrize("graph", ["vae_encoder", "condition_encoder", "denoiser", "vae_decoder"])
def test_damaged_file_is_noticed_before_it_runs(copied, graph, spoil):
    path = copied / f"{graph}.onnx"
    data = bytearray(path.read_bytes())
    if spoil == "missing":
        path.unlink()
    else:
        data[len(data) // 2] ^= spoil == "flipped"
        path.write_bytes({"truncated": data[:-1], "flipped": data, "grown": data + b"\0"}[spoil])
    with pytest.raises(ModelIntegrityError, match=rf"{graph}\.onnx .*Copy the folder again"):
        Relighter.load(copied)


def test_check_of_files_can_be_skipped(copied):
    document = json.loads((copied / MANIFEST_NAME).read_text())
    document["files"][0]["sha256"] = "0" * 64
    write_json(copied / MANIFEST_NAME, document)
    with pytest.raises(ModelIntegrityError):
        Relighter.load(copied)
    Relighter.load(copied, verify_files=False)


def test_summary_has_what_a_table_shows(copied):
    manifest = Manifest.read(copied)
    rows = (ParityRow("unet", "", 1e-3, 2e-5, 1e-4), ParityRow("loop", "", 1e-3, 7e-5, 1e-4))
    source = Source("sd21", "zerocomp", "f" * 64)
    replace(manifest, parity=rows, source=source).write(copied)
    summary = resolve_model(copied).summary()
    assert summary["name"] == "tiny"
    assert summary["backbone"] == "zerocomp-openrooms"
    assert summary["worst_parity"] == 7e-5
    assert summary["bytes"] == sum(p.stat().st_size for p in copied.glob("*.onnx"))
    json.dumps(summary)


def test_unverified_model_has_no_parity(copied):
    assert resolve_model(copied).summary()["worst_parity"] is None


def test_networks_open_on_demand_and_close(backbone):
    networks = open_networks(resolve_model(backbone), threads=1)
    assert list(networks) == ["vae_encoder", "condition_encoder", "denoiser", "vae_decoder"]
    assert len(networks) == 4
    first = networks["denoiser"]
    assert networks["denoiser"] is first
    networks.release("denoiser", "vae_decoder", "nothing")
    assert networks["denoiser"] is not first
    assert "unet" not in networks
    with pytest.raises(KeyError):
        networks["unet"]


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"providers": ["NoProvider"]}, ProviderError, "provider NoProvider is not installed"),
        ({"providers": []}, InvalidInputError, "providers: expected a list"),
        ({"providers": "CPUExecutionProvider"}, InvalidInputError, "providers: expected a list"),
        ({"threads": 0}, InvalidInputError, "threads: expected 1 or more, got 0"),
        ({"threads": -1, "engine": "openvino"}, InvalidInputError, "threads: expected 1 or more"),
    ],
)
def test_what_no_session_could_be_opened_with_is_said_at_once(backbone, changes, error, message):
    with pytest.raises(error, match=message):
        Relighter.load(backbone, **changes)


def test_threads_that_ask_at_once_share_one_session(backbone):
    opened = []

    def slow(folder, contract):
        opened.append(contract.name)
        time.sleep(0.05)
        return lambda **inputs: inputs

    networks = LazyNetworks(resolve_model(backbone), slow)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: networks["denoiser"], range(4)))
    assert opened == ["denoiser"]
    assert len(set(found)) == 1


def test_session_of_a_deleted_file_says_so(copied):
    networks = open_networks(resolve_model(copied), threads=1)
    (copied / "denoiser.onnx").unlink()
    with pytest.raises(ModelError, match=r"denoiser\.onnx"):
        networks["denoiser"]


def test_every_published_backbone_opens(tmp_path):
    for name in ("zerocomp-openrooms-wo-depth", "zerocomp-interiorverse", "zerocomp-inverted"):
        folder = write_backbone(tmp_path / name, tiny_spec(name))
        spec = resolve_model(folder).manifest.backbone
        networks = open_networks(resolve_model(folder), threads=1)
        maps = np.zeros((1, spec.conditioning_channels, 16, 24), np.float32)
        assert networks["condition_encoder"](conditioning=maps)["condition"].shape[2:] == (2, 3)
