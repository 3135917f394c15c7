"""Stable Diffusion 2.1's size, with random weights: memory, exactness, speed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.checkpoints import Checkpoint, write_full_size_checkpoint
from support.scenes import make_scene, make_shadow

from spotlight_export import cases
from spotlight_export.checkpoint import open_checkpoint
from spotlight_export.reference import DenoiserReference
from spotlight_export.sessions import open_graph
from spotlight_export.verify import past_tolerance, verify_model
from spotlight_runtime import read_image, write_image
from spotlight_spec import Manifest

pytestmark = pytest.mark.full

EXPORT = """
import json, sys, time
from spotlight_export.export import export_backbone
from spotlight_runtime.relighting.result import peak_memory_bytes
start = time.perf_counter()
export_backbone("zerocomp", *sys.argv[1:4], layout=sys.argv[4])
seconds = time.perf_counter() - start
print(json.dumps({"seconds": seconds, "peak": peak_memory_bytes()}))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Room for about 13 GB, given back at the end."""
    path = tmp_path_factory.mktemp("full-size")
    yield path
    shutil.rmtree(path)


@pytest.fixture(scope="module")
def checkpoint(folder: Path) -> Checkpoint:
    return write_full_size_checkpoint(folder)


@pytest.fixture(scope="module")
def model(folder: Path, checkpoint: Checkpoint) -> tuple[Path, dict[str, float]]:
    out = folder / "model"
    command = [sys.executable, "-c", EXPORT, checkpoint.base, checkpoint.controlnet, out, "fused"]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    return out, json.loads(result.stdout)


def test_export_needs_less_than_twice_the_models_size(model, capsys):
    folder, measured = model
    files = Manifest.read(folder).files
    size = sum(entry.bytes for entry in files)
    with capsys.disabled():
        print(
            f"\nexport: {measured['seconds']:.0f} s, peak {measured['peak'] / 1e9:.2f} GB "
            f"for a model of {size / 1e9:.2f} GB"
        )
        for entry in files:
            print(f"  {entry.path}: {entry.bytes / 1e6:.1f} MB")
    assert measured["peak"] < 2 * size
    assert {"denoiser.onnx.data"} <= {entry.path for entry in files}


def test_graphs_and_loop_match_torch(model, monkeypatch, capsys):
    monkeypatch.setattr(cases, "QUICK_SHAPES", (((16, 24), 1), ((17, 11), 2)))
    rows = verify_model(model[0])
    with capsys.disabled():
        for row in rows:
            print(f"\n  {row.subject} {row.case}: {row.max_abs:.1e}, {row.max_rel:.1e}", end="")
    assert not past_tolerance(rows)


def test_one_evaluation_next_to_torch(model, checkpoint, capsys):
    """Seconds of one denoiser evaluation at 64×64 latents, the two taking turns."""
    spec = Manifest.read(model[0]).backbone
    rng = np.random.default_rng(0)
    noisy = {
        "latents": rng.standard_normal((1, 4, 64, 64), np.float32),
        "timestep": np.array([999]),
    }
    maps = rng.random((1, spec.conditioning_channels, 512, 512), np.float32)
    reference = DenoiserReference(open_checkpoint(str(checkpoint.base), str(checkpoint.controlnet)))
    graph = open_graph(model[0] / "denoiser.onnx")
    condition = reference.condition_encoder(maps)
    seconds: dict[str, list[float]] = {"torch": [], "onnxruntime": []}
    for _ in range(4):
        start = time.perf_counter()
        expected = reference.denoiser(**noisy, condition=maps)["prediction"]
        middle = time.perf_counter()
        got = graph(**noisy, **condition)["prediction"]
        seconds["torch"].append(middle - start)
        seconds["onnxruntime"].append(time.perf_counter() - middle)
    with capsys.disabled():
        for name, times in seconds.items():
            print(f"\n  {name}: best {min(times):.2f} s, median {np.median(times):.2f} s", end="")
    assert np.abs(got - expected).max() < 1e-4 * np.abs(expected).max()


def test_one_relight_fits_in_eight_gigabytes(model, folder, capsys):
    """A 512×512 relight by the command people type, end to end: 60 evaluations."""
    scene = make_scene(512, 512)
    scene.save(folder / "scene")
    for side in ("left", "right"):
        write_image(folder / f"{side}.png", make_shadow(scene, side))
    command = [
        *(Path(sys.executable).parent / "spotlight", "relight", "scene", "--model", model[0]),
        *("--shadow", "left.png", "--negative", "right.png", "-o", "out.png"),
        *("--report", "report.json", "--no-denoise"),
    ]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    report = json.loads((folder / "report.json").read_text())
    seconds = report["seconds"]
    evaluating = seconds["relight"] + seconds["no shadow"]
    with capsys.disabled():
        print(
            f"\n  relight 512×512: {sum(seconds.values()):.0f} s, of which {report['evaluations']} "
            f"evaluations at {evaluating / report['evaluations']:.2f} s; peak "
            f"{report['peak_memory_bytes'] / 1e9:.2f} GB; {seconds}",
            end="",
        )
    assert report["evaluations"] == 60
    assert report["peak_memory_bytes"] < 8e9
    image = read_image(folder / "out.png")
    assert image.shape == (512, 512, 3)
    assert image[scene.object_mask == 1.0].std() > 0.0
