"""Preparing a relight leaves no thread at work: its networks have all processors at once.

Products of large matrices go to BLAS, whose threads spin for a tenth of a second once they are
done. Networks that ran meanwhile took twice as long.
"""

import time

import numpy as np
import pytest

from spotlight_runtime import Light, Relighter, Scene
from spotlight_runtime.cli.demo import SCENES
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.networks.sessions import available_cpus
from spotlight_runtime.shadows.placement import box_of

pytestmark = pytest.mark.skipif(available_cpus() < 2, reason="with one processor nothing spins")


def at_work(grace=0.01, seconds=0.03):
    """Processors that this process keeps busy, soon after, while nobody asks it for anything."""
    time.sleep(grace)
    began = time.process_time()
    time.sleep(seconds)
    return (time.process_time() - began) / seconds


@pytest.fixture(autouse=True)
def quiet():
    until = time.monotonic() + 10.0
    while at_work() > 0.1:
        assert time.monotonic() < until, "something else of this process is at work"


@pytest.mark.parametrize("folder", sorted(SCENES.iterdir()), ids=lambda folder: folder.name)
def test_nothing_is_left_at_work_by_preparing(folder):
    scene = Scene.load(folder)
    shadow = np.zeros(scene.size, np.float32)
    shadow[scene.size[0] // 2 :] = 0.5
    Relighter.load("mini", threads=1).loop_inputs(scene, shadow)
    assert at_work() < 0.3


@pytest.mark.parametrize("folder", sorted(SCENES.iterdir()), ids=lambda folder: folder.name)
def test_nothing_is_left_at_work_by_casting(folder):
    pytest.importorskip("embreex", reason="needs the scene extra")
    Relighter.load("mini", threads=1).loop_inputs(
        Scene.load(folder), Light(azimuth=120, elevation=40)
    )
    assert at_work() < 0.3


def test_nothing_is_left_at_work_by_a_large_mesh():
    vertices = np.random.default_rng(0).random((300_000, 3), dtype=np.float32)
    box_of(ObjectMesh(vertices, np.array([[0, 1, 2]], dtype=np.int32)), None)
    assert at_work() < 0.3
