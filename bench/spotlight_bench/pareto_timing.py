"""Times of candidates, taken in turns: every round runs each of them once, the exact plan first.

What a machine does beside this, it does to all of a round, so times are held against the exact
plan's of the same round. Nothing is remembered from one relight to the next. Memory is a process's
own, so it is measured in one of its own (`spotlight_bench.pareto_memory`).
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from spotlight_bench.backbone import Backbone
from spotlight_bench.dataset import DOMINANT, load_scene
from spotlight_bench.errors import BenchError
from spotlight_bench.pareto import guide_of
from spotlight_bench.pareto_grid import Candidate
from spotlight_runtime import Relighter, RelightOptions

__all__ = ["MeasureError", "Timing", "peak_memory", "take_times"]

SEED: Final = 0
"""Of the order within a round."""


class MeasureError(BenchError, RuntimeError):
    """A process that was to measure something failed."""


@dataclass(frozen=True, slots=True)
class Timing:
    """One relight by the clock.

    Attributes
    ----------
    round : int
    scene, candidate : str
    seconds : float
        From ready shadows to the picture.
    """

    round: int
    scene: str
    candidate: str
    seconds: float


def take_times(
    backbones: Mapping[str, Backbone],
    candidates: Sequence[Candidate],
    folders: Sequence[Path],
    options: RelightOptions,
    rounds: int,
) -> Iterator[Timing]:
    """Run every candidate once a round, in an order drawn anew.

    Parameters
    ----------
    backbones : mapping of str to Backbone
        By name of the model.
    candidates : sequence of Candidate
        The exact plan first.
    folders : sequence of Path
        Scenes; each round takes the next one's dominant light.
    options : RelightOptions
        What the candidates have in common.
    rounds : int

    Yields
    ------
    Timing
    """
    rng = np.random.default_rng(SEED)
    fresh = {n: Relighter(b.spec, b.networks, remember=0) for n, b in backbones.items()}
    used = {candidate.model for candidate in candidates}
    for number in range(-1, rounds):
        test = load_scene(folders[max(number, 0) % len(folders)], (DOMINANT,))
        guide = guide_of(test.directions[0])
        if number < 0:  # opens the sessions
            for name in used:
                fresh[name].relight(test.scene, guide, options=options, steps=1, plain_steps=1)
            continue
        order = [candidates[0], *rng.permutation(np.array(candidates[1:], dtype=object))]
        for candidate in order:
            start = time.perf_counter()
            fresh[candidate.model].relight(test.scene, guide, options=candidate.apply(options))
            yield Timing(number, test.name, candidate.name, time.perf_counter() - start)


def peak_memory(
    model: str | Path, candidate: Candidate, folder: Path, threads: int | None
) -> int | None:
    """Largest resident size in bytes of a process that runs one relight; None where unknown.

    Raises
    ------
    MeasureError
        If it fails; the message ends as its own did.
    """
    wish = {
        "model": str(model),
        "scene": str(folder),
        "options": candidate.options,
        "threads": threads,
    }
    command = [sys.executable, "-m", "spotlight_bench.pareto_memory", json.dumps(wish)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise MeasureError(f"measuring the memory of {candidate.name} in {folder}: {last}")
    peak: int | None = json.loads(done.stdout)["peak_memory_bytes"]
    return peak
