"""``python -m fuzz.guided``: coverage-guided fuzzing with Atheris (libFuzzer), parser by parser.

The corpus grows from run to run in a folder that git ignores, so a run goes on where the last one
ended. A finding is written beside it and, once mended, moved to ``tests/fuzz/findings``, where
every run of the tests repeats it.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
CORPUS = HERE / "corpus"
LARGEST = 1 << 16
"""Bytes of an input."""
MEMORY_MB = 1200
"""Of the whole process: `guard.MOST_MEMORY` above what Python and the imports take."""
INSTRUMENTED = ["spotlight_runtime", "spotlight_spec", "trimesh.exchange", "trimesh.visual"]


def fuzz_one(name: str, seconds: int) -> None:
    """Fuzz one parser in this process; libFuzzer ends it."""
    import atheris

    with atheris.instrument_imports(include=INSTRUMENTED, enable_loader_override=False):
        from fuzz.guard import Guard
        from fuzz.mutate import mutate
        from fuzz.targets import TARGETS

        target = TARGETS[name]
        guard = Guard(target, Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-")))
        for data in guard.starts:  # what is imported on first use is instrumented, too
            guard(data)
    corpus = CORPUS / name
    corpus.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(guard.starts):
        (corpus / f"seed-{number}").write_bytes(data)

    def mutator(data: bytes, most: int, seed: int) -> bytes:
        changed = mutate(target.shape, data, random.Random(seed), lambda raw, _: atheris.Mutate(
            raw or b"\0", min(most, len(raw) + 64)
        ))  # fmt: skip
        return changed if len(changed) <= most else data

    options = [
        f"-max_total_time={seconds}",
        f"-max_len={LARGEST}",
        f"-rss_limit_mb={MEMORY_MB}",
        f"-malloc_limit_mb={MEMORY_MB}",
        "-timeout=60",
        "-print_final_stats=1",
        f"-artifact_prefix={CORPUS}/found-{name}-",
        str(corpus),
    ]
    atheris.Setup([sys.argv[0], *options], guard, custom_mutator=mutator)
    atheris.Fuzz()


def fuzz_all(names: list[str], minutes: float) -> int:
    """Fuzz each parser in a process of its own, the time split evenly; how many had findings."""
    CORPUS.mkdir(exist_ok=True)
    deadline = time.monotonic() + 60.0 * minutes
    bad = 0
    for number, name in enumerate(names):
        seconds = max(1, int((deadline - time.monotonic()) / (len(names) - number)))
        command = [sys.executable, "-m", "fuzz.guided", "--one", name, "--seconds", str(seconds)]
        paths = [str(HERE.parent), os.environ.get("PYTHONPATH", "")]
        done = subprocess.run(
            command,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            check=False,
        )
        said = done.stdout.decode(errors="replace")
        (CORPUS / f"log-{name}").write_text(said)
        runs = re.search(r"number_of_executed_units: (\d+)", said)
        covered = re.findall(r"cov: (\d+)", said)
        size = len(list((CORPUS / name).glob("*")))
        print(
            f"{name:10s} {seconds:4d} s  {runs[1] if runs else '?':>9s} executions  "
            f"{covered[-1] if covered else '?':>5s} edges  corpus {size:5d}  "
            f"{'ok' if done.returncode == 0 else 'FOUND, see ' + str(CORPUS / f'log-{name}')}",
            flush=True,
        )
        bad += done.returncode != 0
    return bad


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one")
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    if arguments.one:
        fuzz_one(arguments.one, arguments.seconds)
        return
    from fuzz.targets import TARGETS

    sys.exit(1 if fuzz_all(arguments.names or list(TARGETS), arguments.minutes) else 0)


if __name__ == "__main__":
    main()
