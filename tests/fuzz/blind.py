"""``python -m fuzz.blind TARGET EXECUTIONS``: mutations without guidance, the same ones each time.

In a process of its own, so that a parser that takes the process down is noticed, and its memory is
its own. What it found is written to standard output as JSON.
"""

from __future__ import annotations

import json
import random
import sys
import tempfile
from pathlib import Path

from fuzz.guard import Guard, peak_memory
from fuzz.mutate import mutate
from fuzz.targets import TARGETS

__all__ = ["FINDINGS"]

FINDINGS = Path(__file__).parent / "findings"
POOL = 64
"""Mutants that are mutated further, besides the seeds."""


def run(name: str, executions: int) -> dict[str, int]:
    """Fuzz one parser; its findings of earlier days first."""
    target, rng = TARGETS[name], random.Random(f"{name} 469")
    guard = Guard(target, Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-")))
    pool = [*guard.starts]
    for data in pool:
        guard(data)
    refused_seeds = guard.refused

    def work() -> None:
        for path in sorted((FINDINGS / name).glob("*")):
            guard(path.read_bytes())
        for _ in range(executions):
            data = mutate(target.shape, rng.choice(pool), rng)
            before = guard.refused
            Path("latest").write_bytes(data)  # for whoever looks into what broke
            guard(data)
            if guard.refused == before:  # what passes leads on
                if len(pool) >= len(guard.starts) + POOL:
                    pool.pop(rng.randrange(len(guard.starts), len(pool)))
                pool.append(data)

    return {
        "grown": peak_memory(work),
        "executions": guard.executions,
        "refused": guard.refused,
        "refused seeds": refused_seeds,
    }


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], int(sys.argv[2]))))
