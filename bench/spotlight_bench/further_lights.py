"""What a second light of a scene takes, as a share of the first.

Whatever lights of one scene and seed can share is made once: the pass without shadow, and, where
the backbone says that it pays, calls of the network. Each round measures, with a seed of its own,
the first light, a second one afterwards, and both in one request.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final, get_args

import numpy as np
import typer

from spotlight_bench import arguments as a
from spotlight_bench.dataset import TestScene
from spotlight_bench.pareto import guide_of
from spotlight_runtime import GuidingShadow, Relighter, Scene
from spotlight_runtime.planning.ladder import PlanName

__all__ = ["Round", "further_lights", "rounds", "shares"]

WANTED: Final = 0.6
"""Share of the first light's time that a second one may take."""
OPPOSITE: Final = 4
"""Of eight azimuths, how far on the second light is."""


@dataclass(frozen=True, slots=True)
class Round:
    """Seconds of one round.

    Attributes
    ----------
    scene, plan : str
    first, later, both : float
        One light; another one afterwards; the two in one request.
    """

    scene: str
    plan: str
    first: float
    later: float
    both: float


def rounds(
    relighter: Relighter, scenes: Sequence[TestScene], count: int, plans: Sequence[str]
) -> Iterator[Round]:
    """Measure, yielding after each round of each plan.

    Parameters
    ----------
    relighter : Relighter
    scenes : sequence of TestScene
        With at least `OPPOSITE` + 1 directions each; rounds take turns.
    count : int
        Of rounds a plan.
    plans : sequence of str
    """

    def seconds(scene: Scene, guides: list[GuidingShadow], plan: Any, seed: int) -> float:
        start = time.perf_counter()
        relighter.relight_each(scene, guides, plan=plan, seed=seed)
        return time.perf_counter() - start

    for number in range(-1, count):
        test = scenes[max(number, 0) % len(scenes)]
        one, other = (guide_of(test.directions[index]) for index in (0, OPPOSITE))
        for plan in plans:
            seed = 2 * number + 2
            measured = Round(
                test.name,
                plan,
                seconds(test.scene, [one], plan, seed),
                seconds(test.scene, [other], plan, seed),
                seconds(test.scene, [one, other], plan, seed + 1),
            )
            if number >= 0:  # the round before opens the sessions
                yield measured


def shares(found: Sequence[Round]) -> dict[str, float]:
    """Median seconds of the first, and medians of what a second adds to it, of the same round."""
    first, later, both = (
        np.array([getattr(one, n) for one in found]) for n in ("first", "later", "both")
    )
    return {
        "first": float(np.median(first)),
        "later": float(np.median(later / first)),
        "together": float(np.median((both - first) / first)),
    }


def further_lights(
    data: Annotated[
        Path, typer.Argument(metavar="TESTSET", help="Test set: a folder a scene.")
    ] = Path("testset"),
    model: Annotated[str, typer.Option(help="Model name or folder.")] = "mini",
    count: Annotated[int, typer.Option("--rounds", min=1, help="Rounds a plan.")] = 9,
    json_file: a.JsonFile = None,
    threads: a.Threads = None,
) -> None:
    """Measure what a second light of a scene adds to the first.

    Example: spotlight-bench further-lights testset --threads 2
    """
    from rich.console import Console
    from rich.progress import track
    from rich.table import Table

    from spotlight_bench.dataset import azimuth_scenes
    from spotlight_spec import write_json

    scenes = azimuth_scenes(data, count)
    plans = get_args(PlanName)
    run = rounds(Relighter.load(model, threads=threads), scenes, count, plans)
    found = list(track(run, "rounds", count * len(plans), console=Console(stderr=True)))
    figures = {plan: shares([one for one in found if one.plan == plan]) for plan in plans}
    if json_file is not None:
        write_json(json_file, {"shares": figures, "rounds": [asdict(one) for one in found]})
    table = Table(title="A second light, of the first one's time", title_justify="left")
    for name in ("plan", "first, s", "in the same request", "afterwards"):
        table.add_column(name, justify="left" if name == "plan" else "right")
    for plan, of in figures.items():
        table.add_row(plan, f"{of['first']:.3f}", f"{of['together']:.0%}", f"{of['later']:.0%}")
    Console(width=None if sys.stdout.isatty() else 100).print(table)
    kept = figures["exact"]["together"] <= WANTED
    print(f"exact, in the same request, at most {WANTED:.0%}: {'yes' if kept else 'no'}")
