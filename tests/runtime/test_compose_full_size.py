"""A twelve-megapixel photograph is composed by the shipped model in little memory."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pytest
from support.models import write_box

from spotlight_runtime import Scene

pytest.importorskip("embreex", reason="ray casting needs the extra scene")

COMMAND = """
import json, sys, time
from spotlight_runtime.cli import app
from spotlight_runtime.relighting.result import peak_memory_bytes
start = time.perf_counter()
try:
    app(sys.argv[1:], standalone_mode=False)
finally:
    peak = peak_memory_bytes() / 2**20
    print(json.dumps({"peak_mb": peak, "seconds": time.perf_counter() - start}))
"""


@pytest.mark.full
def test_twelve_megapixels_within_a_gigabyte_and_a_half(tmp_path, rng):
    pixels = rng.integers(0, 255, (300, 400, 3), dtype=np.uint8)
    large = cv2.resize(pixels, (4000, 3000), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(tmp_path / "room.jpg"), large)
    write_box(tmp_path / "box.glb", (0.6, 0.8, 0.5))
    output = tmp_path / "scene"
    asked = [
        "--background",
        "room.jpg",
        "--object",
        "box.glb",
        "--horizon",
        "0.3",
        "--at",
        "0.5,0.8",
    ]
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, "compose", *asked, "-o", str(output)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    print(report)
    assert report["peak_mb"] < 1500
    assert sum(file.stat().st_size for file in output.iterdir()) < 60_000_000
    scene = Scene.load(output)
    assert scene.size == (3000, 4000)
    assert scene.object_mask.max() == 1.0
