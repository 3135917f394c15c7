"""What a person sees on stderr while a command works: progress bars and notices."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from spotlight_runtime.errors import ShadowWarning
from spotlight_runtime.relighting.result import Progress

__all__ = ["drained", "notices", "progress_bars"]

Result = TypeVar("Result")


@contextmanager
def progress_bars() -> Iterator[Callable[[Progress], None]]:
    """Bars, one a pass, that the function they come with moves."""
    bars = Bars(
        TextColumn("{task.description:>11}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    tasks = {}

    def show(progress: Progress) -> None:
        name: str = progress.stage
        if progress.lights > 1 and name == "relight":
            name = f"light {progress.light + 1} of {progress.lights}"
        if name not in tasks:
            tasks[name] = bars.add_task(name, total=progress.steps)
        bars.update(tasks[name], completed=progress.step.index + 1)

    with bars:
        yield show


def drained(run: Generator[Progress, None, Result], show: Callable[[Progress], None]) -> Result:
    """Show a run's progress and return its result."""
    while True:
        try:
            show(next(run))
        except StopIteration as stop:
            result: Result = stop.value
            return result


@contextmanager
def notices() -> Iterator[None]:
    """Print what is said about shadows as one line each, not as Python's warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", ShadowWarning)
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *rest: object) -> None:
            if issubclass(category, ShadowWarning):
                print("spotlight: note:", " ".join(str(message).split()), file=sys.stderr)
            else:
                usual(message, category, *rest)  # type: ignore[arg-type]

        warnings.showwarning = show  # type: ignore[assignment]
        yield
