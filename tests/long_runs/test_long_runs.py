"""Two thousand relights and a thousand cancelled ones in one process; eight threads at once."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.onnx_backbone import tiny_spec, write_backbone
from support.scenes import make_scene, make_shadow

from long_runs.slopes import slope_of
from spotlight_runtime import Relighter, RelightOptions

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's accounts")

MIB = 1 << 20
OBJECTS = 500
"""Python objects that caches of the interpreter and numpy may come to hold; a leak of one for each
cancelled generator would be more."""

WARM = 1000
"""Relights before the heap has its shape: all distinct requests have come once after 420, and some
hundred later one last half megabyte is taken, which is all there is in 6,000."""


def long_run(relights, cancelled):
    command = [sys.executable, "-m", "long_runs.workload", str(relights), str(cancelled)]
    tests = str(Path(__file__).parents[1])
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": tests, "OMP_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


def check_flat(values, warm, allowed):
    """After warming up, growth is within noise, or so small that it does not matter."""
    slope = slope_of(values[warm:])
    print(slope)
    assert slope.low <= 0.0 or slope.high < allowed, slope
    return slope


def check_holdings(found, cancelled):
    before, after = found["before"], found["after"]
    assert after["threads"] == before["threads"]
    assert after["files"] == before["files"]
    assert after["objects"] - before["objects"] < min(OBJECTS, cancelled), (before, after)


def test_a_hundred_relights():
    """What the full run does, in little: it would not notice a small leak, but a large one."""
    found = long_run(120, 60)
    check_flat(found["resident"], 40, 8 * MIB)
    check_holdings(found, OBJECTS)
    assert found["pictures"] < 120, "some are repeated, and the same"


@pytest.mark.full
def test_two_thousand_relights():
    found = long_run(WARM + 2000, 1000)
    memory = check_flat(found["resident"], WARM, MIB // 4)
    assert memory.growth < 0.002 * memory.mean
    # Processor time, which the machine's other work moves less than the clock's.
    seconds = check_flat(found["seconds"], WARM, 0.0)
    assert abs(seconds.growth) < 0.5 * seconds.mean
    check_holdings(found, 1000)
    check_flat(found["cancelled"], 200, MIB // 4)
    assert found["pictures"] < 500, "each was made several times, with the same bytes"


def relit_in_threads(relighter, rounds, **options):
    scene = make_scene(48, 64)
    shadow, negative = make_shadow(scene, "left"), make_shadow(scene, "right")
    chosen = replace(RelightOptions(denoise=False), **options)
    seeds = [seed % 3 for seed in range(rounds)]

    def one(seed):
        return relighter.relight(scene, shadow, negative, replace(chosen, seed=seed)).image

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(one, seeds))
    alone = [one(seed) for seed in range(3)]
    for seed, image in zip(seeds, together):
        assert image.tobytes() == alone[seed].tobytes()
    assert not np.array_equal(alone[0], alone[1])


@pytest.mark.parametrize("threads", [1, 2])
def test_eight_threads_give_the_bytes_of_one(tmp_path, threads):
    folder = write_backbone(tmp_path / "tiny", tiny_spec(steps=2))
    relit_in_threads(Relighter.load(folder, threads=threads, remember=0), 24)


def test_eight_threads_on_the_embedded_backbone():
    relit_in_threads(Relighter.load("mini", threads=1, remember=0), 8, steps=2)


@pytest.mark.full
def test_eight_threads_on_the_embedded_backbone_for_long():
    relit_in_threads(Relighter.load("mini", threads=1, remember=0), 80, steps=3)


def test_a_leak_is_noticed():
    """The statistic itself: noise is none, a slow drift under it is one."""
    noise = np.random.default_rng(0).normal(0.0, 1.0, 1600)
    drift = np.linspace(0.0, 1.0, 1600)
    assert slope_of(100.0 + noise).low <= 0.0
    with pytest.raises(AssertionError):
        check_flat(list(100.0 + noise + drift), 0, 0.5)
