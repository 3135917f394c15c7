"""Every parser against mutated files: a result, or an error of the runtime, and nothing else."""

import json
import os
import random
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("trimesh", reason="models need the extra scene")
pytest.importorskip("embreex", reason="models need the extra scene")

from fuzz import seeds
from fuzz.guard import MOST_MEMORY, peak_memory
from fuzz.mutate import mutate
from fuzz.targets import TARGETS

TESTS = Path(__file__).parents[1]
EXECUTIONS = 400


@pytest.mark.parametrize("name", TARGETS)
def test_parser_keeps_its_promises(name, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "fuzz.blind", name, str(EXECUTIONS)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(TESTS), "TMPDIR": str(tmp_path)},
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["executions"] > EXECUTIONS
    assert found["grown"] < MOST_MEMORY
    mutants = found["executions"] - found["refused"]
    assert mutants > 20, "most mutants must not fail the first check, or nothing is tested"
    assert found["refused"] > found["refused seeds"] + 20, "damage must be noticed, too"


PROMISES = {
    "raises another error": (lambda data: {}[data], "KeyError is no error of the runtime"),
    "warns": (lambda data: np.float32(3e38) * np.float32(10), "RuntimeWarning is no error"),
    "reads outside": (lambda data: Path(__file__).read_bytes(), "went outside its folder"),
    "writes outside": (lambda data: os.makedirs(TESTS, exist_ok=True), "went outside its folder"),
    "starts a process": (lambda data: subprocess.run(["true"], check=True), "went outside"),
    "leaves a file": (lambda data: tempfile.mkdtemp(), "in the temporary folder"),
    "hangs": (lambda data: time.sleep(60), "Timeout"),
}


@pytest.mark.parametrize("broken", PROMISES)
def test_a_broken_promise_is_noticed(broken, tmp_path):
    """The guard itself, in a process of its own: an audit hook stays as long as its process."""
    script = f"""
        import sys
        from pathlib import Path
        from fuzz import guard
        from fuzz.targets import Target
        from fuzz.test_parsers import PROMISES
        guard.MOST_SECONDS = 2
        run, _ = PROMISES[{broken!r}]
        guard.Guard(Target("t", "bytes", lambda folder: (run, [])), Path(sys.argv[1]))(b"x")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "guarded")],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(TESTS)},
        check=False,
    )
    assert done.returncode != 0
    assert PROMISES[broken][1] in done.stderr


def test_memory_taken_and_given_back_is_noticed():
    # More than the C library ever serves from what it has kept of earlier tests (32 MiB).
    assert peak_memory(lambda: np.ones(64 << 20, np.uint8)) >= 62 << 20


def test_the_mutator_says_the_same_twice_and_seldom_nothing_new(tmp_path):
    for target in TARGETS.values():
        _, starts = target.make(seeds.fresh(tmp_path / target.name))
        start = next(iter(starts))
        made = [mutate(target.shape, start, random.Random(i)) for i in range(40)]
        assert made == [mutate(target.shape, start, random.Random(i)) for i in range(40)]
        assert len({start, *made}) > 30
