"""The training loop all three networks share: mixed precision, EMA, resumable, and looked at.

A run folder holds ``checkpoint.pt`` (written by write-then-rename), ``loss.csv``, ``loss.png`` and
``samples.png``. The same code trains on CPU (bf16 where the processor has it) and on CUDA.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor, nn

__all__ = ["CHECKPOINT_FILE", "TrainingOptions", "train"]

Batch = dict[str, Tensor]
Draw = Callable[[np.random.Generator], dict[str, Any]]
CHECKPOINT_FILE: Final = "checkpoint.pt"
PRINT_EVERY: Final = 50
"""Steps between lines where no terminal shows the bar."""


@dataclass(frozen=True)
class TrainingOptions:
    """How long and how fast.

    Attributes
    ----------
    steps : int
        Optimiser steps in all; the learning rate decays to 0 over them (cosine).
    minutes : float or None
        Stop (resumably) after so much time.
    batch : int
    learning_rate : float
    warmup : int
        Steps of linear warm-up.
    ema : float
        Decay of the averaged weights, reached gradually; short, because runs here are.
    seed : int
    device : str
        ``cpu`` or ``cuda``.
    threads : int
        Threads that prepare batches.
    sample_every : int
        Steps between sample sheets and checkpoints.
    samples : int
        Pictures on a sheet.
    coarse_every : int
        One step in so many takes four times as many pictures of half the side, where there are
        any; 0: none.
    """

    steps: int = 20_000
    minutes: float | None = None
    batch: int = 8
    learning_rate: float = 3e-4
    warmup: int = 200
    ema: float = 0.995
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    sample_every: int = 500
    samples: int = 6
    coarse_every: int = 0


@contextmanager
def _denormals_flushed() -> Iterator[None]:
    """While training: gradients of half-trained layers cost thirty times as much with them."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)  # whoever trained goes on with all of its floats


@_denormals_flushed()
def train(
    model: nn.Module,
    loss: Callable[[nn.Module, Batch, torch.Generator], dict[str, Tensor]],
    draw: Draw,
    run: Path,
    options: TrainingOptions,
    sheet: Callable[[nn.Module, Path], None],
    coarse: Draw | None = None,
) -> nn.Module:
    """Train, or continue the run found in ``run``.

    Parameters
    ----------
    model : Module
        Parameters that require gradients are trained.
    loss : callable
        ``loss(model, batch, generator)`` → named terms; their sum is minimised.
    draw : callable
        ``draw(rng)`` → one sample of named arrays.
    run : Path
        Folder of the run.
    options : TrainingOptions
    sheet : callable
        ``sheet(averaged_model, path)`` draws what the model does on held-out samples.
    coarse : callable, optional
        As ``draw``, at half the side.

    Returns
    -------
    Module
        The averaged model.

    Raises
    ------
    FloatingPointError
        If the loss is not finite; the last checkpoint is untouched.
    """
    run.mkdir(parents=True, exist_ok=True)
    device = torch.device(options.device)
    half = _bfloat16_pays(device)
    model.to(device)
    averaged = _frozen_copy(model)
    trained = [p for p in model.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(trained, lr=options.learning_rate, weight_decay=1e-4)
    start = _resume(run, model, averaged, optimiser, device)
    deadline = None if options.minutes is None else time.monotonic() + 60.0 * options.minutes
    log = _Log(run, start)
    batches = _Prefetcher(draw, coarse, options, start)
    with _progress() as bar:
        task = bar.add_task("loss –", total=options.steps, completed=start)
        for step in range(start, options.steps):
            generator = torch.Generator(device).manual_seed(options.seed * 1_000_003 + step)
            batch = {k: v.to(device, non_blocking=True) for k, v in batches.take().items()}
            for group in optimiser.param_groups:
                group["lr"] = _learning_rate(step, options)
            with torch.autocast(device.type, torch.bfloat16, enabled=half):
                terms = loss(model, batch, generator)
            total = torch.stack([term.float() for term in terms.values()]).sum()
            if not torch.isfinite(total):
                raise FloatingPointError(f"step {step}: the loss is {float(total)}; terms {terms}")
            optimiser.zero_grad(set_to_none=True)
            total.backward()
            nn.utils.clip_grad_norm_(trained, 1.0)
            optimiser.step()
            _average(averaged, model, min(options.ema, (1 + step) / (10 + step)))
            log.add(step, terms)
            bar.update(task, advance=1, description=f"loss {log.recent:.4f}")
            done = step + 1
            if not bar.console.is_terminal and done % PRINT_EVERY == 0:
                bar.console.print(f"{done}/{options.steps} loss {log.recent:.4f}")
            late = deadline is not None and time.monotonic() > deadline
            if done % options.sample_every == 0 or done == options.steps or late:
                _save(run, model, averaged, optimiser, done)
                log.flush()
                sheet(averaged, run / "samples.png")
            if late:
                break
    batches.close()
    return averaged


def _bfloat16_pays(device: torch.device) -> bool:
    """Whether the processor multiplies bfloat16 itself; emulated, it is several times slower."""
    return device.type != "cpu" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def _learning_rate(step: int, options: TrainingOptions) -> float:
    warm = min(1.0, (step + 1) / options.warmup)
    return options.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * step / options.steps))


def _frozen_copy(model: nn.Module) -> nn.Module:
    import copy

    return copy.deepcopy(model).eval().requires_grad_(False)


@torch.no_grad()
def _average(averaged: nn.Module, model: nn.Module, decay: float) -> None:
    for mean, value in zip(averaged.parameters(), model.parameters()):
        mean.lerp_(value, 1.0 - decay)


def _save(
    run: Path, model: nn.Module, averaged: nn.Module, optimiser: Any, steps_done: int
) -> None:
    state = {
        "model": model.state_dict(),
        "averaged": averaged.state_dict(),
        "optimiser": optimiser.state_dict(),
        "steps_done": steps_done,
    }
    partial = run / f"{CHECKPOINT_FILE}.partial"
    torch.save(state, partial)
    partial.replace(run / CHECKPOINT_FILE)


def _resume(
    run: Path, model: nn.Module, averaged: nn.Module, optimiser: Any, device: torch.device
) -> int:
    path = run / CHECKPOINT_FILE
    if not path.is_file():
        return 0
    state = torch.load(path, map_location=device, weights_only=True)
    model.load_state_dict(state["model"])
    averaged.load_state_dict(state["averaged"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["steps_done"])


class _Prefetcher:
    """Batches prepared ahead in threads; batch ``n`` depends on the seed and ``n`` alone."""

    def __init__(
        self, draw: Draw, coarse: Draw | None, options: TrainingOptions, start: int
    ) -> None:
        self._draw, self._coarse, self._options, self._next = draw, coarse, options, start
        self._pool = ThreadPoolExecutor(options.threads)
        self._queue: list[Future[Batch]] = []

    def take(self) -> Batch:
        """The next batch."""
        while len(self._queue) < 2 * self._options.threads:
            self._queue.append(self._pool.submit(self._make, self._next))
            self._next += 1
        return self._queue.pop(0).result()

    def close(self) -> None:
        """Drop what was prepared."""
        self._pool.shutdown(cancel_futures=True)

    def _make(self, number: int) -> Batch:
        rng = np.random.default_rng([self._options.seed, number])
        draw, count = self._draw, self._options.batch
        every = self._options.coarse_every
        if self._coarse is not None and every and number % every == 0:
            draw, count = self._coarse, 4 * count
        samples = [draw(rng) for _ in range(count)]
        return {k: torch.from_numpy(np.stack([s[k] for s in samples])) for k in samples[0]}


class _Log:
    """Loss terms as CSV and a curve."""

    def __init__(self, run: Path, start: int) -> None:
        self._csv, self._png = run / "loss.csv", run / "loss.png"
        self._rows: list[tuple[int, dict[str, float]]] = []
        self.recent = math.nan
        if start and self._csv.is_file():
            with self._csv.open() as stream:
                for row in csv.DictReader(stream):
                    step = int(row.pop("step"))
                    if step < start:
                        self._rows.append((step, {k: float(v) for k, v in row.items()}))

    def add(self, step: int, terms: dict[str, Tensor]) -> None:
        """Remember one step."""
        values = {name: float(term.detach()) for name, term in terms.items()}
        self._rows.append((step, values))
        total = sum(values.values())
        self.recent = total if math.isnan(self.recent) else 0.98 * self.recent + 0.02 * total

    def flush(self) -> None:
        """Write CSV and curve."""
        from matplotlib.figure import Figure

        names = list(self._rows[-1][1])
        with self._csv.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["step", *names])
            writer.writerows([step, *(f"{v[n]:.6g}" for n in names)] for step, v in self._rows)
        figure = Figure(figsize=(7, 3.5), layout="constrained")
        axes = figure.subplots()
        width = max(1, len(self._rows) // 300)
        for name in names:
            values = np.array([v[name] for _, v in self._rows])
            means = np.convolve(values, np.full(width, 1.0 / width), mode="valid")
            axes.plot([s for s, _ in self._rows][width - 1 :], means, label=name)
        axes.set(xlabel="step", ylabel="loss", yscale="log")
        axes.legend()
        axes.grid(alpha=0.3)
        figure.savefig(self._png, dpi=100)


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    )
