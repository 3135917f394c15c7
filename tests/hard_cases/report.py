"""The catalogue as a table, with how near each room's hardest case comes to its tolerance.

``PYTHONPATH=tests python -m hard_cases.report docs/stability.md``
"""

from __future__ import annotations

import sys
from pathlib import Path

from spotlight_bench.stability_report import write_section

from .case import compare
from .test_catalogue import REGISTRIES

ROOMS = {
    "loop_cases": "whole runs of the loop, float32 and float64",
    "latent_cases": "schedule, conversions, guidance, rescale, masks, blending, noise",
    "map_cases": "shading quotient, depth alignment, compositing of maps",
    "picture_cases": "transfer curves, ratio images, colour balance, object light, light mixing",
    "precision_cases": "half and int8",
    "estimator_cases": "maps estimated from photographs",
    "relight_cases": "whole relights with a tiny backbone",
}


def catalogue() -> str:
    """One row a room; cases that take minutes are counted and not run."""
    lines = [
        "| what | agree with the oracle | end in a documented error | nearest to its tolerance |",
        "|---|---:|---:|---|",
    ]
    for module in REGISTRIES:
        name = module.__name__.rpartition(".")[2]
        cases, refusals = module.CASES, getattr(module, "REFUSALS", [])
        worst, hardest = max((compare(case), case.name) for case in cases if not case.full)
        assert worst <= 1.0, f"{hardest} is beyond its tolerance"
        lines.append(f"| {ROOMS[name]} | {len(cases)} | {len(refusals)} | {hardest}: {worst:.0%} |")
    return "\n".join(lines)


if __name__ == "__main__":
    write_section(Path(sys.argv[1]), "catalogue", catalogue())
