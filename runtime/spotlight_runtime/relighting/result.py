"""What a relight returns, and what it measured on the way."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.sampler import Step
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.planning.plan import Plan
from spotlight_runtime.relighting.guides import GuidingShadow
from spotlight_runtime.relighting.window import Window

__all__ = ["PassName", "Progress", "RelightResult", "Stopwatch", "peak_memory_bytes"]

PassName = Literal["relight", "no shadow"]


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """Where a relight is.

    Attributes
    ----------
    stage : {"relight", "no shadow"}
        The pass.
    step : Step
        Its latest step; `Relighter.preview_of` shows it.
    steps : int
        How many the pass has.
    light, lights : int
        Which light the pass is for, from 0, of how many; the pass without shadow is for all.
    window : Window
        What part of the photograph is diffused.
    """

    stage: PassName
    step: Step
    steps: int
    light: int
    lights: int
    window: Window


@dataclass(frozen=True, slots=True, eq=False)
class RelightResult:
    """A relit picture and how it came about.

    Attributes
    ----------
    image : ndarray of float32, shape (H, W, 3)
        The picture at the photograph's size, sRGB-encoded, in [0, 1].
    prediction, no_shadow : ndarray of float32, shape (h, w, 3)
        The renderer's own pictures with and without the guiding shadow, before they are composed
        with the background: what is in the window, at the model's scale; sRGB-encoded, in [0, 1].
    options : RelightOptions
        As used, with nothing left to default.
    plan : Plan
        What was run, what was left out, and why.
    timings : dict of float
        Seconds by stage. Where each light has a picture of its own, what all lights share counts
        for the first, and what some went through together for each in equal parts.
    denoised : str
        ``on``, or why not.
    window : Window
        What part of the photograph was diffused, and at what size.
    guides : tuple of GuidingShadow
        The shadows that guided, one a light.
    model : dict
        Facts about the model.
    """

    image: FloatArray
    prediction: FloatArray
    no_shadow: FloatArray
    options: RelightOptions
    plan: Plan
    timings: dict[str, float]
    denoised: str
    window: Window
    guides: tuple[GuidingShadow, ...]
    model: dict[str, Any] = field(default_factory=dict)

    @property
    def evaluations(self) -> int:
        """Denoiser evaluations, one a branch and step."""
        return self.plan.evaluations

    def report(self) -> dict[str, Any]:
        """Everything but the pixels, ready for JSON."""
        return {
            "model": self.model,
            "size": {"width": self.image.shape[1], "height": self.image.shape[0]},
            "window": asdict(self.window),
            "lights": len(self.guides),
            "options": asdict(self.options),
            "evaluations": self.evaluations,
            "plan": self.plan.report(),
            "denoised": self.denoised,
            "seconds": {stage: round(seconds, 4) for stage, seconds in self.timings.items()},
            "peak_memory_bytes": peak_memory_bytes(),
        }


class Stopwatch:
    """Seconds by stage, summed where a stage is entered again."""

    def __init__(self, seconds: Mapping[str, float] | None = None) -> None:
        self.seconds = dict(seconds or {})

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Charge the time of the ``with`` block to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.charge({name: time.perf_counter() - start})

    def charge(self, seconds: Mapping[str, float], among: int = 1) -> None:
        """Add one of so many equal parts of seconds by stage."""
        for name, taken in seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + taken / among


def peak_memory_bytes(status: Path = Path("/proc/self/status")) -> int | None:
    """Largest resident size of this process so far; None where the platform does not say.

    Linux's own account comes first: what ``getrusage`` says there starts from the size of the
    process that started this one.
    """
    try:
        lines = status.read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM:"))
    except (OSError, StopIteration):
        pass
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
