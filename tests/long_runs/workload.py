"""``python -m long_runs.workload RELIGHTS CANCELLED``: a long run in a process of its own.

Prints, as JSON, resident bytes and processor seconds of every relight, what is left of cancelled
ones, and a digest of every distinct picture.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from support.onnx_backbone import tiny_spec, write_backbone
from support.scenes import make_scene, make_shadow

from long_runs.slopes import resident_bytes
from spotlight_runtime import Relighter, RelightOptions

SEEDS = 5
COLLECT = 10
"""Relights after which cyclic garbage is collected: what waits for the collector, who by himself
comes once in a thousand relights, is no leak but looks like one."""
SOLVERS = ("ddim", "dpmpp_2m", "unipc")


def main(relights: int, cancelled: int) -> dict[str, object]:
    """Run; relights differ by seed, solver, light and size, as a service's do."""
    folder = write_backbone(Path(tempfile.mkdtemp()) / "tiny", tiny_spec(steps=2))
    relighter = Relighter.load(folder, threads=1)
    plain = RelightOptions(denoise=False)
    scenes = [make_scene(32, 48), make_scene(40, 40), make_scene(100, 120)]
    shadows = [[make_shadow(scene, side) for side in ("left", "right")] for scene in scenes]
    # Room for the accounts beforehand: a list of them would grow, and be taken for a leak.
    resident, held = np.ones(relights, np.int64), np.ones(cancelled, np.int64)
    seconds = np.ones(relights)
    digests: dict[str, str] = {}
    for i in range(relights):
        which, seed, solver = i % len(scenes), i % SEEDS, SOLVERS[i % 2]
        positive, negative = shadows[which][:: 1 if i % 4 < 2 else -1]
        options = replace(plain, seed=seed, solver=solver, gamma=1.0 if i % 7 == 0 else 3.0)
        start = time.process_time()
        result = relighter.relight(scenes[which], positive, negative, options)
        seconds[i] = time.process_time() - start
        if i % COLLECT == 0:
            gc.collect()
        resident[i] = resident_bytes()
        key = f"{which} {i % 4 < 2} {options.seed} {options.solver} {options.gamma}"
        digest = hashlib.sha256(result.image.tobytes()).hexdigest()
        assert digests.setdefault(key, digest) == digest, f"relight {i} differs from an earlier one"
        del result
    before = _holdings()
    for i in range(cancelled):
        run = relighter.run(scenes[i % 3], shadows[i % 3][0], options=replace(plain, seed=i))
        for _ in range(i % 3):
            next(run)
        if i % 2:
            run.close()
        del run  # or just let go of
        if i % COLLECT == 0:
            gc.collect()
        held[i] = resident_bytes()
    after = _holdings()
    return {
        "resident": resident.tolist(),
        "seconds": seconds.tolist(),
        "pictures": len(digests),
        "cancelled": held.tolist(),
        "before": before,
        "after": after,
    }


def _holdings() -> dict[str, int]:
    gc.collect()
    return {
        "objects": len(gc.get_objects()),
        "threads": threading.active_count(),
        "files": len(os.listdir("/proc/self/fd")),
    }


if __name__ == "__main__":
    print(json.dumps(main(int(sys.argv[1]), int(sys.argv[2]))))
