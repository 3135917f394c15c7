"""What the sweep sweeps: every combination of savings that is one of its own.

The axes are those of `RelightOptions` that trade accuracy for time: solver, steps, steps in which
the branches are contrasted, steps of the pass without shadow, steps that share deep features,
window. Combinations that come to the same plan (half of two steps and half of three, rounded) are
one candidate. Every saving is combined with all solvers and steps; of guidance in some steps,
shared features and another window only one at a time, for they save the same evaluations or none.
Of few steps in a coarse window, which leave little else to save, guidance in some is tried.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final

from spotlight_bench.errors import MethodError
from spotlight_runtime import RelightOptions

__all__ = ["EXACT", "FULL", "QUICK", "Candidate", "Grid", "candidates"]

EXACT: Final = "exact"
LATER: Final = (1 / 3, 1.0)
"""Steps to contrast the branches in: in the first of few the shadow is not in the latents yet, and
both branches know the same."""
FEW: Final = 4
"""Steps in which guidance in some of them goes with a coarse window, at most."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One way to relight for less.

    Attributes
    ----------
    name : str
        ``exact``, or what it does: ``unipc-6-p3-tight``.
    options : dict
        Fields of `RelightOptions` that differ from the exact plan's.
    model : str
        Which of the models it runs on.
    """

    name: str
    options: dict[str, Any] = field(default_factory=dict)
    model: str = ""

    @property
    def how(self) -> str:
        """What sets its pictures apart in stored results."""
        return f"{self.model} {sorted(self.options.items())}"

    def apply(self, base: RelightOptions) -> RelightOptions:
        """The options it runs with."""
        return replace(base, **self.options)


@dataclass(frozen=True, slots=True)
class Grid:
    """The axes of a sweep.

    Attributes
    ----------
    solvers : tuple of str
    steps : tuple of int
    intervals : tuple of (float, float)
        Shares of the steps between which the branches are contrasted.
    plain : tuple of float
        Steps of the pass without shadow, as shares of the steps.
    windows : tuple of str
    reuses : tuple of int
        In one of how many steps the whole denoiser is evaluated.
    """

    solvers: tuple[str, ...]
    steps: tuple[int, ...]
    intervals: tuple[tuple[float, float], ...]
    plain: tuple[float, ...]
    windows: tuple[str, ...]
    reuses: tuple[int, ...] = (1,)


FULL: Final = Grid(
    solvers=("ddim", "dpmpp_2m", "unipc"),
    steps=(20, 12, 8, 6, 4, 3, 2, 1),
    intervals=((0.0, 1.0), LATER),
    plain=(1.0, 0.5, 0.25),
    windows=("auto", "tight", "coarse"),
    reuses=(1, 2, 3),
)
QUICK: Final = Grid(
    solvers=("ddim", "unipc"),
    steps=(12, 6, 4, 2, 1),
    intervals=((0.0, 1.0), LATER),
    plain=(1.0, 0.5),
    windows=("auto",),
    reuses=(1, 3),
)


def candidates(
    grid: Grid, own_steps: int, models: tuple[str, ...], reusing: Collection[str] = ()
) -> tuple[Candidate, ...]:
    """The exact plan and every saving of the grid, on every model.

    Parameters
    ----------
    grid : Grid
    own_steps : int
        The backbone's usual number of steps; more are left out.
    models : tuple of str
        The first is what the others are held against; it has the plain names.
    reusing : collection of str
        Those of them that can share deep features between steps.

    Returns
    -------
    tuple of Candidate
        The first is the exact plan on the first model.

    Raises
    ------
    MethodError
        If two models have one name.
    """
    if len(set(models)) < len(models):
        raise MethodError(
            f"model: expected models of different names, got {', '.join(models)}; rename a folder"
        )
    found = [Candidate(EXACT, {}, models[0])]
    for model in models:
        if model != models[0]:
            found.append(Candidate(f"{model}:{EXACT}", {}, model))
        prefix = "" if model == models[0] else f"{model}:"
        swept = grid if model in reusing else replace(grid, reuses=(1,))
        found += [Candidate(prefix + name, o, model) for name, o in _savings(swept, own_steps)]
    return tuple(found)


def _savings(grid: Grid, own_steps: int) -> Iterator[tuple[str, dict[str, Any]]]:
    seen = {("ddim", own_steps, 0, own_steps, own_steps, "auto", 1)}
    axes = (grid.solvers, grid.steps, grid.intervals, grid.plain, grid.windows, grid.reuses)
    for solver, steps, interval, share, window, every in product(*axes):
        first, last = (round(end * steps) for end in interval)
        plain = max(1, round(share * steps))
        reuse = min(every, steps)
        key = (solver, steps, first, last, plain, window, reuse)
        # Contrasted in no step at all, the light would not steer the object's shading.
        unguided = first >= last
        another = solver != "ddim" and steps == 1  # all solvers take one step alike
        some = (first, last) != (0, steps)
        savings = (some, reuse > 1, window != "auto")
        tried = savings == (True, False, True) and window == "coarse" and steps <= FEW
        crossed = sum(savings) > 1 and not tried
        if steps > own_steps or unguided or another or crossed or key in seen:
            continue
        seen.add(key)
        options: dict[str, Any] = {"solver": solver, "steps": steps}
        name = f"{solver}-{steps}"
        if some:
            options["guidance_interval"] = list(interval)
            low, high = (round(100 * end) for end in interval)
            name += f"-g{low}to{high}"
        if plain != steps:
            options["plain_steps"] = plain
            name += f"-p{plain}"
        if reuse > 1:
            options["reuse"] = reuse
            name += f"-r{reuse}"
        if window != "auto":
            options["window"] = window
            name += f"-{window}"
        yield name, options
