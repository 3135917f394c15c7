"""A model folder's manifest: written whole, read strictly, and able to tell damage."""

import json
from dataclasses import replace

import pytest

from spotlight_spec import (
    BACKBONES,
    MANIFEST_NAME,
    FileEntry,
    Manifest,
    ParityRow,
    RecordError,
    Source,
    graph_contracts,
    sha256_of,
    write_json,
)


@pytest.fixture
def folder(tmp_path):
    """A model folder with two files, one of them in a subfolder."""
    (tmp_path / "denoiser.onnx").write_bytes(bytes(range(256)) * 8)
    (tmp_path / "data").mkdir()
    (tmp_path / "data/denoiser.onnx.data").write_bytes(b"weights" * 100)
    paths = ["denoiser.onnx", "data/denoiser.onnx.data"]
    spec = BACKBONES["mini"]
    manifest = Manifest(
        backbone=spec,
        graphs=tuple(
            c for c in graph_contracts(spec, condition_channels=4) if c.name == "denoiser"
        ),
        layout="fused",
        precision="int8",
        opset=21,
        files=tuple(
            FileEntry(p, (tmp_path / p).stat().st_size, sha256_of(tmp_path / p)) for p in paths
        ),
        source=Source("base", None, "f" * 64),
        exporter={"torch": "2.13"},
        parity=(ParityRow("loop", "64×64, 20 steps", 1e-4, 1e-5, 1e-4),),
        licence="Apache-2.0",
        provenance={"trained on": "renders"},
    )
    manifest.write(tmp_path)
    return tmp_path


def test_manifest_round_trip(folder):
    manifest = Manifest.read(folder)
    assert manifest.backbone == BACKBONES["mini"]
    assert manifest.parity[0].case == "64×64, 20 steps"
    manifest.write(folder)
    assert Manifest.read(folder) == manifest


def test_whole_folder_has_no_damage(folder):
    assert Manifest.read(folder).damaged_files(folder) == []


def test_missing_file_is_named(folder):
    (folder / "denoiser.onnx").unlink()
    assert Manifest.read(folder).damaged_files(folder) == ["denoiser.onnx is missing"]


def test_folder_in_place_of_a_file_is_a_missing_file(folder):
    (folder / "denoiser.onnx").unlink()
    (folder / "denoiser.onnx").mkdir()
    assert Manifest.read(folder).damaged_files(folder) == ["denoiser.onnx is missing"]


@pytest.mark.parametrize("keep", [0, 1, 2047])
def test_truncated_file_is_named_with_both_sizes(folder, keep):
    path = folder / "denoiser.onnx"
    path.write_bytes(path.read_bytes()[:keep])
    assert Manifest.read(folder).damaged_files(folder) == [
        f"denoiser.onnx has {keep} bytes, expected 2048"
    ]


@pytest.mark.parametrize("offset", [0, 350, 699])
def test_one_flipped_bit_is_noticed(folder, offset):
    path = folder / "data/denoiser.onnx.data"
    data = bytearray(path.read_bytes())
    data[offset] ^= 1
    path.write_bytes(data)
    (problem,) = Manifest.read(folder).damaged_files(folder)
    assert problem.startswith(f"data/denoiser.onnx.data has sha256 {sha256_of(path)}, expected ")


def test_every_damaged_file_is_listed(folder):
    (folder / "denoiser.onnx").unlink()
    (folder / "data/denoiser.onnx.data").write_bytes(b"")
    assert len(Manifest.read(folder).damaged_files(folder)) == 2


@pytest.mark.parametrize(
    "path", ["", ".", "/etc/passwd", "..", "../other/denoiser.onnx", "data/../../denoiser.onnx"]
)
def test_path_that_leaves_the_folder_is_refused(folder, path):
    with pytest.raises(ValueError, match="must stay inside the model folder"):
        FileEntry(path, 1, "0" * 64)
    document = json.loads((folder / MANIFEST_NAME).read_text())
    document["files"][0]["path"] = path
    write_json(folder / MANIFEST_NAME, document)
    with pytest.raises(RecordError, match=r"files\[0\]: file path .* must stay inside"):
        Manifest.read(folder)


@pytest.mark.parametrize("number", [0, 2, -1])
def test_other_format_says_what_to_do(folder, number):
    document = json.loads((folder / MANIFEST_NAME).read_text()) | {"format": number}
    write_json(folder / MANIFEST_NAME, document)
    with pytest.raises(RecordError, match=f"manifest format {number} is not 1; export the model"):
        Manifest.read(folder)


def test_other_format_is_said_before_its_unknown_keys(folder):
    document = json.loads((folder / MANIFEST_NAME).read_text()) | {"format": 2, "signature": "x"}
    write_json(folder / MANIFEST_NAME, document)
    with pytest.raises(RecordError, match="manifest format 2 is not 1"):
        Manifest.read(folder)


def test_graph_whose_file_is_not_listed_is_damage(folder):
    document = json.loads((folder / MANIFEST_NAME).read_text())
    del document["files"][0]
    write_json(folder / MANIFEST_NAME, document)
    (problem,) = Manifest.read(folder).damaged_files(folder)
    assert problem.startswith("denoiser.onnx is not listed")


def test_manifest_error_names_the_file(folder):
    document = json.loads((folder / MANIFEST_NAME).read_text()) | {"opset": "21"}
    write_json(folder / MANIFEST_NAME, document)
    with pytest.raises(RecordError, match=rf"{MANIFEST_NAME}\.opset: expected a whole number"):
        Manifest.read(folder)


def test_folder_without_manifest(tmp_path):
    with pytest.raises(FileNotFoundError):
        Manifest.read(tmp_path)


def test_truncated_manifest_is_no_manifest(folder):
    path = folder / MANIFEST_NAME
    data = path.read_bytes()
    for keep in range(0, len(data) - 2, 97):
        path.write_bytes(data[:keep])
        with pytest.raises(RecordError):
            Manifest.read(folder)


def test_failed_write_keeps_the_old_manifest(folder):
    old = Manifest.read(folder)
    broken = replace(old, parity=(ParityRow("loop", "", 0.0, 0.0, float("inf")),))
    with pytest.raises(ValueError, match="JSON"):
        broken.write(folder)
    assert Manifest.read(folder) == old


def test_write_leaves_nothing_else_behind(folder):
    assert sorted(p.name for p in folder.iterdir()) == ["data", "denoiser.onnx", MANIFEST_NAME]


def test_reader_never_meets_half_a_manifest(folder):
    """The old file is replaced, never rewritten: who opened it goes on reading the old one."""
    with (folder / MANIFEST_NAME).open() as stream:
        Manifest.read(folder).write(folder)
        assert json.loads(stream.read())["opset"] == 21


def test_graph_by_name(folder):
    manifest = Manifest.read(folder)
    assert manifest.graph("denoiser").file_name == "denoiser.onnx"
    with pytest.raises(KeyError, match="unet"):
        manifest.graph("unet")


def test_sha256_of_a_known_text(tmp_path):
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_of(tmp_path / "abc").startswith("ba7816bf8f01cfea414140de5dae2223")


def test_failed_write_leaves_no_part_behind(tmp_path):
    (tmp_path / "report.json").mkdir()
    with pytest.raises(OSError, match="report"):
        write_json(tmp_path / "report.json", {})
    assert [p.name for p in tmp_path.iterdir()] == ["report.json"]
