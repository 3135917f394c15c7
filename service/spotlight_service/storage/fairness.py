"""Whose turn it is: callers take turns, each caller's own jobs go first come, first served."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

__all__ = ["Waiting", "fair_order"]


@dataclass(frozen=True, slots=True)
class Waiting:
    """A job that waits.

    Attributes
    ----------
    id : str
    owner : str
    ticket : int
        Grows with every submission.
    """

    id: str
    owner: str
    ticket: int


def fair_order(
    waiting: Sequence[Waiting], turns: Mapping[str, int], running: Mapping[str, int]
) -> list[str]:
    """The order in which waiting jobs will be begun, if nothing else happens.

    Next is always a job of the caller with the fewest running, among these of the one whose last
    turn is longest ago, among these of the one who has waited longest.

    Parameters
    ----------
    waiting : sequence of Waiting
    turns : mapping of str to int
        When each caller had its last turn; who is not in it never had one.
    running : mapping of str to int
        How many jobs of each caller run.

    Returns
    -------
    list of str
        Every id, in order. The jobs of n callers are interleaved: none waits for more than one
        job of another for each of its own.
    """
    lines: dict[str, deque[Waiting]] = {}
    for job in sorted(waiting, key=lambda each: each.ticket):
        lines.setdefault(job.owner, deque()).append(job)
    last, busy = dict(turns), Counter(running)
    now = max(last.values(), default=0)
    order = []
    while lines:
        owner = min(lines, key=lambda o: (busy[o], last.get(o, -1), lines[o][0].ticket))
        order.append(lines[owner].popleft().id)
        now += 1
        last[owner], busy[owner] = now, busy[owner] + 1
        if not lines[owner]:
            del lines[owner]
    return order
