"""What each part of a relight costs on this machine, in seconds.

Measured by `spotlight_runtime.relighting.calibration`, kept for an hour in the user's cache, one a
model and machine, and asked by the rules for every effect they switch.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np

from spotlight_runtime.networks.sessions import runtime_version
from spotlight_spec import write_json

__all__ = [
    "Costs",
    "Line",
    "Pace",
    "Seconds",
    "cache_path",
    "outdated",
    "read_costs",
    "write_costs",
]

VERSION: Final = 7
"""Of the cache file; files of another version are measured anew."""
KEPT: Final = 3600.0
"""Seconds for which costs are believed. Six hours later a virtual machine took a tenth longer for
long relights and a fifth less for short ones, and 82 % of requests were predicted instead of 99."""
TRUST: Final = 0.2
"""Share of a relight's surprise that the next prediction takes on: a single one may be chance."""
EVALUATIONS: Final = ("evaluation", "shallow", "start")
"""Costs of the denoiser."""
SURPRISE: Final = math.log(2.0)
"""The most that counts: one that opened sessions, or stood still meanwhile, took much longer."""


@dataclass(frozen=True, slots=True)
class Line:
    """Seconds as a straight line of a size, never below the least measured.

    Attributes
    ----------
    fixed : float
        Seconds the line starts from; below 0 where what is small runs from the caches.
    each : float
        Seconds for each unit of the size.
    least : float
        Seconds of whatever is smaller than what was measured.
    """

    fixed: float
    each: float
    least: float = 0.0

    @classmethod
    def through(cls, sizes: list[float], seconds: list[float]) -> Self:
        """The line through two or more measurements (least squares), rising."""
        if len(set(sizes)) == 1:
            return cls(0.0, max(seconds) / sizes[0])
        each, fixed = (float(c) for c in np.polyfit(sizes, seconds, 1))
        if each <= 0.0:
            return cls(float(np.mean(seconds)), 0.0)
        return cls(fixed, each, max(0.0, fixed + each * min(sizes)))

    def at(self, size: float) -> float:
        """Seconds at a size."""
        return max(self.least, self.fixed + self.each * size)

    def slowed(self, factor: float) -> Line:
        """The line where everything takes so many times as long."""
        return Line(self.fixed * factor, self.each * factor, self.least * factor)


@dataclass(frozen=True, slots=True)
class Costs:
    """Seconds of every stage of a relight.

    Attributes
    ----------
    evaluation, condition, encode, decode : Line
        Of one branch, by the number of latents (height × width).
    frame : Line
        Putting a whole photograph diffused at its own scale together, by its pixels.
    window : Line
        Putting a window back into a larger photograph, by the photograph's pixels.
    shallow : Line
        Of one branch, an evaluation that goes without the deep part; 0 where the model has none.
    start : Line
        By how much the first evaluation of a pass takes longer than those after it: other graphs
        ran in between, and its memory and threads are cold.
    """

    evaluation: Line
    condition: Line
    encode: Line
    decode: Line
    frame: Line
    window: Line
    shallow: Line = Line(0.0, 0.0)
    start: Line = Line(0.0, 0.0)

    def evaluations(self, latents: int, whole: int, shallow: int, passes: int) -> float:
        """Seconds of evaluations of one branch, with the deep part and without, in some passes."""
        each = whole * self.evaluation.at(latents) + shallow * self.shallow.at(latents)
        return each + passes * self.start.at(latents)

    def composite(self, pixels: int, native: bool) -> float:
        """Seconds to put a picture of so many pixels together."""
        return (self.frame if native else self.window).at(pixels)

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Self:
        """What `dataclasses.asdict` made a record of.

        Raises
        ------
        ValueError
            If the record is not one.
        """
        lines = {name: Line(**record[name]) for name in cls.__dataclass_fields__}
        for name, line in lines.items():
            for value in (line.fixed, line.each, line.least):
                if not (isinstance(value, float) and math.isfinite(value)):
                    raise ValueError(f"{name}: expected seconds, got {value!r}")
            if min(line.each, line.least) < 0.0:
                raise ValueError(f"{name}: expected seconds that rise from 0 up, got {line}")
        return cls(**lines)


class Seconds(NamedTuple):
    """What a relight takes, without what was over when its plan was made.

    Attributes
    ----------
    evaluations : float
        Of the denoiser.
    rest : float
        Encoding, decoding, putting together.
    """

    evaluations: float
    rest: float


class Pace:
    """How long relights have taken of late, in multiples of what costs add up to.

    Costs are measured once, and a machine does not stay as it was then: it warms up, it is shared,
    and what runs for minutes runs slower than what ran for a second. Evaluations, which keep all
    cores at work, and what is around them have paces of their own. Not kept with the costs, as the
    next process may meet another day.
    """

    def __init__(self) -> None:
        self._evaluations = self._rest = 0.0  # logarithms

    def learn(self, predicted: Seconds, actual: Seconds) -> None:
        """Take note of a relight.

        Parameters
        ----------
        predicted, actual : Seconds
            Predicted at this pace. Where there was nothing of a part, nothing is learnt of it.
        """
        self._evaluations += _surprise(predicted.evaluations, actual.evaluations)
        self._rest += _surprise(predicted.rest, actual.rest)

    def of(self, costs: Costs) -> Costs:
        """Costs at this pace."""
        lines = {name: getattr(costs, name) for name in Costs.__dataclass_fields__}
        slowed = {
            name: line.slowed(math.exp(self._evaluations if name in EVALUATIONS else self._rest))
            for name, line in lines.items()
        }
        return Costs(**slowed)


def _surprise(predicted: float, actual: float) -> float:
    """By how much the logarithm of a pace changes."""
    if min(predicted, actual) <= 0.0:
        return 0.0
    return TRUST * min(max(math.log(actual / predicted), -SURPRISE), SURPRISE)


def cache_path(model: str, threads: int | None) -> Path:
    """Where the costs of a model on this machine are kept."""
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = hashlib.sha256(f"{model}\n{_machine(threads)}".encode()).hexdigest()
    return root / "spotlight-relight" / "costs" / f"{digest[:24]}.json"


def read_costs(path: Path) -> Costs | None:
    """The costs kept there; None where there are none that can be used."""
    try:
        record = json.loads(path.read_text())
        return Costs.from_dict(record["costs"]) if record["version"] == VERSION else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def outdated(path: Path) -> bool:
    """Whether costs were kept there so long ago that the machine may have another pace by now.

    The clock is the machine's running time, which nobody sets; after a restart it may be before
    what was noted, and the costs count as old.
    """
    try:
        age = time.monotonic() - float(json.loads(path.read_text())["measured"])
    except (OSError, ValueError, KeyError, TypeError):
        return False  # there are none
    return not 0.0 <= age <= KEPT


def write_costs(path: Path, costs: Costs) -> None:
    """Keep costs, where the cache can be written to; write-then-rename."""
    record = {"version": VERSION, "measured": time.monotonic(), "costs": asdict(costs)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, record)
    except OSError:
        return  # they are measured again next time


def _machine(threads: int | None) -> str:
    """What times depend on besides the model: processor, cores in use, ONNX Runtime."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    facts = [platform.node(), platform.machine(), _processor(), str(usable), str(threads)]
    return "; ".join([*facts, "onnxruntime " + runtime_version()])


def _processor() -> str:
    """The processor's name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if "model name" in line), "")
