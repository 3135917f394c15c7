"""Peers: the release's loop on other engines beside ours, each in a process of its own.

Rounds go through all peers in turn, so what the machine does beside falls on all of them; ratios
are of one round. A peer's memory is its process's, and no two are alive at once.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from spotlight_bench.errors import BenchError
from spotlight_spec import write_json

__all__ = ["RELEASE", "Measured", "Peer", "PeerError", "Row", "among", "measure", "rows"]

RELEASE: Final = "release"
"""The public release's loop as a plan: 60 evaluations at 20 steps, nothing left out."""


class PeerError(BenchError, RuntimeError):
    """A peer's process failed."""


@dataclass(frozen=True, slots=True)
class Peer:
    """An engine with the networks it is to run.

    Attributes
    ----------
    name, label : str
    engine : {"torch", "onnxruntime", "openvino", "spotlight"}
    source : Path
        A checkpoint, a folder of graphs or a model folder: `spotlight_bench.peers_engines`.
    precision : str
    plans : tuple of str
        What it relights by: ``release``, and of ours also named plans.
    low_memory : bool
        Hold only the session at work; of ours alone.
    """

    name: str
    label: str
    engine: str
    source: Path
    precision: str = "fp32"
    plans: tuple[str, ...] = (RELEASE,)
    low_memory: bool = False


@dataclass(frozen=True, slots=True)
class Measured:
    """One process's work.

    Attributes
    ----------
    round : int
    peer : str
    evaluation_seconds : list of float
    relight_seconds : dict of float
        By plan; empty in rounds without relights.
    relight_evaluations : dict of int
    load_seconds : float
        Opening and compiling.
    peak_memory_bytes : int or None
    """

    round: int
    peer: str
    evaluation_seconds: list[float]
    relight_seconds: dict[str, float]
    relight_evaluations: dict[str, int]
    load_seconds: float
    peak_memory_bytes: int | None


@dataclass(frozen=True, slots=True)
class Row:
    """A peer and plan in the table.

    Attributes
    ----------
    peer : Peer
    evaluation_seconds : float
        Median over rounds, as are the relight's.
    times_ours : float
        How many times our first peer's seconds it takes; median of the ratios of one round.
    peak_memory_bytes : int or None
    load_seconds : float
    evaluation_error : float
        Relative L2 error of a prediction against the first peer's.
    plan : str
        Empty where no relight was run; what follows is None then.
    evaluations : int or None
    relight_seconds : float or None
    relight_times_ours : float or None
        Against our balanced relight.
    relight_error : float or None
        Of the picture.
    """

    peer: Peer
    evaluation_seconds: float
    times_ours: float
    peak_memory_bytes: int | None
    load_seconds: float
    evaluation_error: float
    plan: str = ""
    evaluations: int | None = None
    relight_seconds: float | None = None
    relight_times_ours: float | None = None
    relight_error: float | None = None


@dataclass(frozen=True, slots=True)
class _Wish:
    """What `spotlight_bench.peers_worker` is asked."""

    engine: str
    source: str
    precision: str
    spec: str
    side: int
    threads: int
    evaluations: int
    relights: list[str]
    output: str
    low_memory: bool


def among(peers: Sequence[Peer], wanted: Sequence[str]) -> tuple[Peer, ...]:
    """Those of some names; all where none is given.

    Raises
    ------
    PeerError
        If there is no such peer, or none of ours is left to hold the others against.
    """
    known = [peer.name for peer in peers]
    if unknown := [name for name in wanted if name not in known]:
        raise PeerError(f"peers: expected some of {', '.join(known)}, got {', '.join(unknown)}")
    left = tuple(peer for peer in peers if not wanted or peer.name in wanted)
    if not any(peer.engine == "spotlight" for peer in left):
        raise PeerError(f"peers: expected one of ours among {', '.join(wanted)}")
    return left


def measure(
    peers: Sequence[Peer],
    spec: Path,
    output: Path,
    *,
    side: int,
    threads: int,
    rounds: int,
    relights: int,
    evaluations: int,
) -> Iterator[Measured]:
    """Run every peer once a round, beginning with another each time.

    Parameters
    ----------
    peers : sequence of Peer
    spec : Path
        Model folder of ours, whose backbone all are.
    output : Path
        What came out of each is kept below it.
    side : int
        Of the square photograph.
    threads : int
    rounds : int
    relights : int
        In so many first rounds whole relights are run; 0: evaluations alone.
    evaluations : int
        Timed a round and peer.

    Yields
    ------
    Measured

    Raises
    ------
    PeerError
        If a process fails; the message ends as its own did.
    """
    for number in range(rounds):
        turn = number % len(peers)
        for peer in (*peers[turn:], *peers[:turn]):
            wish = _Wish(
                peer.engine, str(peer.source), peer.precision, str(spec), side, threads,
                evaluations, list(peer.plans) if number < relights else [],
                str(output / peer.name), peer.low_memory,
            )  # fmt: skip
            yield Measured(number, peer.name, **_worked(peer, wish, output))


def rows(peers: Sequence[Peer], measured: Sequence[Measured], output: Path) -> tuple[Row, ...]:
    """The table: a row a peer and plan.

    Parameters
    ----------
    peers : sequence of Peer
        The first is what errors are held against; the first of ours what times are.
    measured : sequence of Measured
    output : Path
        As `measure` had it.
    """
    ours = next(peer for peer in peers if peer.engine == "spotlight")
    best = "balanced" if "balanced" in ours.plans else ours.plans[0]
    found: list[Row] = []
    for peer in peers:
        own = [each for each in measured if each.peer == peer.name]
        memory = [m.peak_memory_bytes for m in own if m.peak_memory_bytes is not None]
        row = Row(
            peer,
            evaluation_seconds=float(np.median([np.median(m.evaluation_seconds) for m in own])),
            times_ours=_ratio(_evaluations(own), _evaluations(_of(measured, ours))),
            peak_memory_bytes=max(memory, default=None),
            load_seconds=float(np.median([m.load_seconds for m in own])),
            evaluation_error=_error(output, peer, peers[0], "predictions.npy", "predictions.npy"),
        )
        relit = [plan for plan in peer.plans if _relights(own, plan)]
        found += [
            replace(
                row,
                plan=plan,
                evaluations=next(
                    m.relight_evaluations[plan] for m in own if plan in m.relight_evaluations
                ),
                relight_seconds=float(np.median(list(_relights(own, plan).values()))),
                relight_times_ours=_ratio(
                    _relights(own, plan), _relights(_of(measured, ours), best)
                ),
                relight_error=_error(
                    output, peer, peers[0], f"relight_{plan}.npy", "relight_release.npy"
                ),
            )
            for plan in relit
        ] or [row]
    return tuple(found)


def _worked(peer: Peer, wish: _Wish, output: Path) -> dict[str, Any]:
    output.mkdir(parents=True, exist_ok=True)
    path = output / f"{peer.name}.wish.json"
    write_json(path, {name: getattr(wish, name) for name in _Wish.__dataclass_fields__})
    command = [sys.executable, "-m", "spotlight_bench.peers_worker", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise PeerError(f"peer {peer.label}: {last}")
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def _of(measured: Sequence[Measured], peer: Peer) -> list[Measured]:
    return [each for each in measured if each.peer == peer.name]


def _evaluations(own: Sequence[Measured]) -> dict[int, float]:
    """Median seconds of an evaluation, by round."""
    return {m.round: float(np.median(m.evaluation_seconds)) for m in own}


def _relights(own: Sequence[Measured], plan: str) -> dict[int, float]:
    """Seconds of a relight, by round."""
    return {m.round: m.relight_seconds[plan] for m in own if plan in m.relight_seconds}


def _ratio(one: dict[int, float], other: dict[int, float]) -> float:
    return float(np.median([one[r] / other[r] for r in sorted(set(one) & set(other))]))


def _error(output: Path, peer: Peer, reference: Peer, file: str, wanted: str) -> float:
    got = np.load(output / peer.name / file).astype(np.float64)
    want = np.load(output / reference.name / wanted).astype(np.float64)
    return float(np.linalg.norm(got - want) / np.linalg.norm(want))
