"""Clocks that jump: times are measured by a clock that does not, and nothing else asks."""

import ast
from pathlib import Path

import pytest

import spotlight_runtime
import spotlight_spec
from faults.processes import python

SOURCES = [
    path
    for package in (spotlight_runtime, spotlight_spec)
    for path in sorted(Path(package.__file__).parent.rglob("*.py"))
]
WALL = {"time", "time_ns", "localtime", "gmtime", "ctime", "now", "utcnow", "today", "strftime"}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_nothing_asks_what_time_it_is(path):
    asked = [
        node.lineno
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute)
        and node.attr in WALL
        and isinstance(node.value, ast.Name)
        and node.value.id in ("time", "datetime", "date")
    ]
    assert not asked, f"{path}: lines {asked}"


RELIGHT = """
    import hashlib, sys, time
    hours = iter(range(10**9))
    if sys.argv[3] == "jumps":
        true = time.time
        time.time = lambda: true() + (-1) ** next(hours) * 86_400.0 * (next(hours) % 50)
        time.time_ns = lambda: int(1e9 * time.time())
    from spotlight_runtime import Relighter, Scene, read_image
    relighter = Relighter.load(sys.argv[2], threads=1)
    scene = Scene.load(sys.argv[1] + "/scene")
    result = relighter.relight(scene, read_image(sys.argv[1] + "/shadow.png"), denoise=False)
    assert all(0.0 <= seconds < 600.0 for seconds in result.timings.values()), result.timings
    assert "prepare" in result.timings
    print(hashlib.sha256(result.image.tobytes()).hexdigest())
"""


def test_relight_under_a_jumping_clock(place, backbone):
    steady, jumping = (python(RELIGHT, place, backbone, how) for how in ("steady", "jumps"))
    assert jumping.returncode == 0, jumping.stderr
    assert jumping.stdout == steady.stdout
