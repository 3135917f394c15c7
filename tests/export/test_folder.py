"""A model folder is whole or absent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from spotlight_export.convert import convert_model
from spotlight_export.errors import ModelFolderError, OutputFolderError, QuantisationError
from spotlight_export.export import export_backbone
from spotlight_export.folder import new_model_folder, read_model
from spotlight_runtime.networks.models import ModelFolder, open_networks
from spotlight_spec import MANIFEST_NAME, Manifest


@pytest.mark.parametrize("model", ["int8", "half", "split", "fused"])  # int8 is made from fused
def test_an_export_leaves_exactly_the_files_its_manifest_names(model, request):
    folder = request.getfixturevalue(model)
    manifest = Manifest.read(folder)
    assert {path.name for path in folder.iterdir()} == {
        MANIFEST_NAME,
        *(entry.path for entry in manifest.files),
    }
    assert not manifest.damaged_files(folder)
    assert not [path for path in folder.parent.iterdir() if "partial" in path.name]


def test_a_finetuned_unet_and_int8_in_one_export(checkpoint, tmp_path):
    manifest = export_backbone(
        "zerocomp",
        checkpoint.base,
        checkpoint.controlnet,
        tmp_path / "out",
        unet=checkpoint.base / "unet",
        precision="int8",
    )
    assert manifest.source.unet == str(checkpoint.base / "unet")
    assert manifest.precision == "int8"
    assert {path.name for path in tmp_path.iterdir()} == {"out"}
    assert not (tmp_path / "out" / "float32").exists()


def test_the_runtime_opens_it(fused):
    networks = open_networks(ModelFolder(fused, Manifest.read(fused)))
    assert set(networks) == {"vae_encoder", "condition_encoder", "denoiser", "vae_decoder"}
    assert all(callable(networks[name]) for name in networks)


def test_a_failing_export_leaves_nothing(tmp_path):
    def fail_midway() -> None:
        with new_model_folder(tmp_path / "out") as folder:
            (folder / "half.onnx").write_bytes(b"half")
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        fail_midway()
    assert list(tmp_path.iterdir()) == []


def test_a_killed_export_never_looks_like_a_model(tmp_path):
    script = (
        "import sys, time, pathlib; from spotlight_export.folder import new_model_folder\n"
        "with new_model_folder(pathlib.Path(sys.argv[1])) as folder:\n"
        "    (folder / 'denoiser.onnx').write_bytes(b'half')\n"
        "    print('ready', flush=True); time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path / "out")], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        os.kill(process.pid, signal.SIGKILL)
    deadline = time.monotonic() + 10
    while process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    (left,) = tmp_path.iterdir()
    assert ".partial-" in left.name
    with pytest.raises(ModelFolderError, match="not a model folder"):
        read_model(left)
    with new_model_folder(tmp_path / "out"):
        pass  # what was left behind does not stand in the way
    assert (tmp_path / "out").is_dir()


def test_a_folder_of_something_else_is_never_replaced(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with (
        pytest.raises(OutputFolderError, match="not a model folder"),
        new_model_folder(tmp_path, force=True),
    ):
        pass
    assert (tmp_path / "thesis.tex").exists()


def test_a_file_is_not_a_folder(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputFolderError, match="is a file"), new_model_folder(tmp_path / "out"):
        pass


def test_a_model_is_replaced_only_by_force(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / MANIFEST_NAME).write_text("{}")
    with pytest.raises(OutputFolderError, match="--force"), new_model_folder(out):
        pass
    with new_model_folder(out, force=True) as folder:
        (folder / "new").write_text("")
    assert [path.name for path in out.iterdir()] == ["new"]


def test_a_changed_file_is_noticed(fused, tmp_path):
    manifest = Manifest.read(fused)
    for entry in manifest.files:
        (tmp_path / entry.path).write_bytes((fused / entry.path).read_bytes()[:-1])
    manifest.write(tmp_path)
    with pytest.raises(ModelFolderError, match="expected"):
        read_model(tmp_path)


def test_precision_is_lost_only_once(half, tmp_path):
    with pytest.raises(QuantisationError, match="stored as fp16"):
        convert_model(half, tmp_path / "out", "int8")
