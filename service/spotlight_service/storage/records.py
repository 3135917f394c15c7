"""What a job is, as it lies in the store."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass
from typing import Any, Final, Literal

from spotlight_service.problems import ProblemError

__all__ = ["FINAL", "Claim", "Job", "QueueFullError", "State", "Submission", "job_of"]

State = Literal["queued", "running", "done", "failed", "cancelled"]
FINAL: Final = ("done", "failed", "cancelled")
"""States that a job does not leave."""


@dataclass(frozen=True, slots=True)
class Job:
    """A job.

    Attributes
    ----------
    id, owner, model : str
        The owner is the id of the key that made it.
    state : State
    request : dict
        What is to be done, complete.
    digest : str
        SHA-256 of the request as it was sent.
    created, deadline : float
        Seconds since 1970.
    started, finished : float, optional
    attempt : int
        How often it was begun.
    cancelling : bool
        Whether it will stop at the end of its step.
    ticket, revision : int
        Numbers that grow with every submission, and with every change of any job.
    progress : dict, optional
        ``stage, step, steps, light, lights, evaluations, of, seconds``.
    plan : dict, optional
        What will be run, known once it has begun.
    error : dict, optional
        Problem document of a failed job.
    report : dict, optional
        Of a finished one.
    preview : int
        Number of the latest preview picture; 0: none.
    """

    id: str
    owner: str
    model: str
    state: State
    request: dict[str, Any]
    digest: str
    ticket: int
    created: float
    deadline: float
    started: float | None
    finished: float | None
    attempt: int
    cancelling: bool
    progress: dict[str, Any] | None
    plan: dict[str, Any] | None
    error: dict[str, Any] | None
    report: dict[str, Any] | None
    preview: int
    revision: int

    @property
    def final(self) -> bool:
        """Whether nothing will change any more."""
        return self.state in FINAL


@dataclass(frozen=True, slots=True)
class Claim:
    """A job that a worker has begun; of no effect once another has begun it again.

    Attributes
    ----------
    job : Job
    worker : str
    """

    job: Job
    worker: str


@dataclass(frozen=True, slots=True)
class Submission:
    """What became of a submission.

    Attributes
    ----------
    job : Job
    created : bool
        False where the idempotency key was known: the job is the one it named.
    """

    job: Job
    created: bool


class QueueFullError(ProblemError):
    """Too many jobs wait."""

    def __init__(self, waiting: int, wait_s: float, free_s: float) -> None:
        retry = max(1, round(free_s))
        super().__init__(
            429,
            f"queue: expected fewer than {waiting} waiting jobs, got {waiting}; a new one would "
            f"wait about {wait_s:.0f} s, try again in {retry} s",
            [{"field": "queue", "expected": f"fewer than {waiting} jobs", "got": str(waiting)}],
            {"Retry-After": str(retry)},
            wait_s=round(wait_s, 1),
        )


def job_of(row: sqlite3.Row) -> Job:
    """The job in a row of the table."""

    def read(column: str) -> Any:
        return None if row[column] is None else json.loads(row[column])

    return Job(
        id=row["id"],
        owner=row["owner"],
        model=row["model"],
        state=row["state"],
        request=read("request"),
        digest=row["digest"],
        ticket=row["ticket"],
        created=row["created"],
        deadline=row["deadline"],
        started=row["started"],
        finished=row["finished"],
        attempt=row["attempt"],
        cancelling=bool(row["cancelling"]),
        progress=read("progress"),
        plan=read("plan"),
        error=read("error"),
        report=read("report"),
        preview=row["preview"],
        revision=row["revision"],
    )
