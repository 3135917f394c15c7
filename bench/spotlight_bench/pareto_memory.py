"""One relight in a process of its own, for its peak memory: `spotlight_bench.pareto_timing`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from spotlight_bench.dataset import DOMINANT, load_scene
from spotlight_runtime import GuidingShadow, Relighter, RelightOptions
from spotlight_runtime.relighting.result import peak_memory_bytes

__all__ = ["main"]


def main(wish: str) -> None:
    """Relight by the dominant light as the JSON in ``wish`` says, and print what it took."""
    asked = json.loads(wish)
    relighter = Relighter.load(asked["model"], threads=asked["threads"], remember=0)
    test = load_scene(Path(asked["scene"]), (DOMINANT,))
    (direction,) = test.directions
    guide = GuidingShadow(direction.shadow, direction.opposite)
    relighter.relight(test.scene, guide, options=RelightOptions(**asked["options"]))
    print(json.dumps({"peak_memory_bytes": peak_memory_bytes()}))


if __name__ == "__main__":
    main(sys.argv[1])
