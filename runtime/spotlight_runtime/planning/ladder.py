"""Named plans and the ladder a budget chooses from: options in order of their measured accuracy.

The ladder is written by ``spotlight-bench pareto`` from what it measured on the evaluation scenes;
a budget takes the highest rung whose predicted time fits.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal, get_args

from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.planning.options import RelightOptions

__all__ = ["LADDER_FILE", "PlanName", "Rung", "named_rung", "read_ladder"]

PlanName = Literal["exact", "balanced", "draft"]

LADDER_FILE: Final = Path(__file__).with_name("ladder.json")


@dataclass(frozen=True, slots=True)
class Rung:
    """Options with a known price.

    Attributes
    ----------
    name : str
        ``exact``, ``balanced`` and ``draft`` are among them.
    options : dict
        Fields of `RelightOptions` that differ from the exact plan's.
    loss_db : float or None
        PSNR of the object against the truth that is lost, compared with the exact plan, on the
        evaluation scenes; below 0 where it gained.
    fidelity_db : float or None
        PSNR against the exact plan's own pictures: what rungs descend in.
    """

    name: str
    options: dict[str, Any]
    loss_db: float | None
    fidelity_db: float | None = None


@cache
def read_ladder(reusable: bool = True, path: Path = LADDER_FILE) -> tuple[Rung, ...]:
    """The rungs, the most accurate first.

    Parameters
    ----------
    reusable : bool
        Whether the model can reuse deep features between steps; there is a ladder for those that
        cannot.
    path : Path

    Raises
    ------
    ValueError
        If the file is not a ladder that ``spotlight-bench pareto`` writes.
    """
    records = json.loads(path.read_text())["rungs" if reusable else "rungs_without_reuse"]
    rungs = tuple(Rung(**record) for record in records)
    for rung in rungs:
        RelightOptions(**rung.options)  # raises where one is none
    if missing := set(get_args(PlanName)) - {rung.name for rung in rungs}:
        raise ValueError(f"{path}: expected plans {get_args(PlanName)}, found no {missing}")
    return rungs


def named_rung(name: str, reusable: bool = True) -> Rung:
    """The rung of a named plan; see `read_ladder`.

    Raises
    ------
    InvalidInputError
        If there is no such plan.
    """
    if name not in get_args(PlanName):
        raise InvalidInputError(f"plan: expected {', '.join(get_args(PlanName))}, got {name!r}")
    return next(rung for rung in read_ladder(reusable) if rung.name == name)
