"""The job store as callers see it: submit, look, cancel.

::

    queued ──claim──► running ──finish──► done | failed | cancelled
      ▲                  │
      └──release, lease──┘

Every transition is one transaction; `WorkQueue` has those that workers make.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final

from spotlight_service.problems import FieldError
from spotlight_service.storage.database import Database, bump
from spotlight_service.storage.fairness import Waiting, fair_order
from spotlight_service.storage.records import Job, QueueFullError, State, Submission, job_of

__all__ = ["JobStore", "order"]

RECENT: Final = 16
"""Finished jobs that say how long the next will take."""
FIRST_GUESS_S: Final = 10.0
"""Seconds a job takes where none has finished yet."""
WATCHED_S: Final = 10.0
"""Seconds a watcher counts as watching after it last said so."""

Read = Callable[..., Sequence[sqlite3.Row]]


class JobStore:
    """Jobs in a database, for any number of processes.

    Parameters
    ----------
    database : Database
    limit : int
        Jobs that may wait.
    clock : callable
        Seconds since 1970.
    """

    def __init__(
        self, database: Database, *, limit: int = 32, clock: Callable[[], float] = time.time
    ) -> None:
        self._db, self._clock, self._limit = database, clock, limit

    def submit(
        self,
        job: str,
        owner: str,
        model: str,
        request: dict[str, Any],
        digest: str,
        deadline: float,
        idempotency: str | None = None,
    ) -> Submission:
        """Put a job into the queue.

        Parameters
        ----------
        job, owner, model : str
            The id is the caller's to choose, so that files can be there before the job is.
        request : dict
        digest : str
        deadline : float
            Seconds from now.
        idempotency : str, optional
            A key that makes the same submission only once.

        Raises
        ------
        QueueFullError
        FieldError
            If the key was used for another request.
        """
        now = self._clock()
        with self._db.writing() as connection:
            if idempotency is not None:
                known = connection.execute(
                    "SELECT * FROM jobs WHERE owner = ? AND idempotency = ?", (owner, idempotency)
                ).fetchone()
                if known is not None:
                    return Submission(_same(job_of(known), digest), created=False)
            (waiting,) = connection.execute(
                "SELECT count(*) FROM jobs WHERE state = 'queued'"
            ).fetchone()
            if waiting >= self._limit:
                each = self._seconds(connection, model)
                raise QueueFullError(waiting, each * (waiting + 1), each)
            connection.execute(
                "INSERT INTO jobs (id, owner, model, state, request, digest, idempotency, ticket,"
                " created, deadline, revision) VALUES (?, ?, ?, 'queued', ?, ?, ?, ?, ?, ?, ?)",
                (
                    *(job, owner, model, json.dumps(request), digest, idempotency),
                    *(
                        bump(connection, "ticket"),
                        now,
                        now + deadline,
                        bump(connection, "revision"),
                    ),
                ),
            )
            made = connection.execute("SELECT * FROM jobs WHERE id = ?", (job,)).fetchone()
        return Submission(job_of(made), created=True)

    def get(self, job: str, owner: str) -> Job | None:
        """A caller's job; None where there is none, or it is another's."""
        row = self._db.row("SELECT * FROM jobs WHERE id = ? AND owner = ?", job, owner)
        return None if row is None else job_of(row)

    def keyed(self, owner: str, idempotency: str) -> Job | None:
        """The job that a caller's idempotency key names."""
        row = self._db.row(
            "SELECT * FROM jobs WHERE owner = ? AND idempotency = ?", owner, idempotency
        )
        return None if row is None else job_of(row)

    def latest(self, owner: str, most: int) -> list[Job]:
        """A caller's jobs, newest first."""
        query = "SELECT * FROM jobs WHERE owner = ? ORDER BY ticket DESC LIMIT ?"
        return [job_of(row) for row in self._db.rows(query, owner, most)]

    def changes(self, since: int, most: int = 500) -> list[Job]:
        """Jobs whose latest change is younger than a revision, oldest change first."""
        query = "SELECT * FROM jobs WHERE revision > ? ORDER BY revision LIMIT ?"
        return [job_of(row) for row in self._db.rows(query, since, most)]

    def revision(self) -> int:
        """The number of the latest change."""
        row = self._db.row("SELECT value FROM counters WHERE name = 'revision'")
        return 0 if row is None else int(row["value"])

    def position(self, job: Job) -> int:
        """How many jobs will be begun before a waiting one; 0 for any other."""
        line = order(self._db.rows, job.model)
        return line.index(job.id) if job.id in line else 0

    def counts(self) -> Counter[tuple[str, State]]:
        """Number of jobs by model and state."""
        query = "SELECT model, state, count(*) AS many FROM jobs GROUP BY model, state"
        return Counter({(r["model"], r["state"]): r["many"] for r in self._db.rows(query)})

    def scenes_in_use(self) -> set[str]:
        """Ids of scenes that jobs still need."""
        query = "SELECT DISTINCT json_extract(request, '$.scene') AS scene FROM jobs WHERE state"
        return {row["scene"] for row in self._db.rows(f"{query} IN ('queued', 'running')")}

    def seconds(self, model: str) -> float:
        """How long one job of a model has lately taken."""
        return self._seconds(None, model)

    def cancel(self, job: str, owner: str) -> Job | None:
        """Cancel a caller's job: at once while it waits, at the end of its step while it runs."""
        with self._db.writing() as connection:
            connection.execute(
                "UPDATE jobs SET state = iif(state = 'queued', 'cancelled', state),"
                " finished = iif(state = 'queued', ?, finished), cancelling = 1, revision = ?"
                " WHERE id = ? AND owner = ? AND state IN ('queued', 'running')",
                (self._clock(), bump(connection, "revision"), job, owner),
            )
        return self.get(job, owner)

    def watch(self, job: str) -> None:
        """Say that somebody looks at a job's events, for the next seconds."""
        with self._db.writing() as connection:
            until = self._clock() + WATCHED_S
            connection.execute("UPDATE jobs SET watched = ? WHERE id = ?", (until, job))

    def expire(self, age: float) -> list[str]:
        """Forget jobs that finished so many seconds ago; returns their ids."""
        with self._db.writing() as connection:
            gone = connection.execute(
                "DELETE FROM jobs WHERE finished < ? RETURNING id", (self._clock() - age,)
            ).fetchall()
        return [row["id"] for row in gone]

    def ids(self) -> set[str]:
        """Of all jobs there are."""
        return {row["id"] for row in self._db.rows("SELECT id FROM jobs")}

    def _seconds(self, connection: sqlite3.Connection | None, model: str) -> float:
        query = (
            "SELECT avg(finished - started) AS mean FROM (SELECT * FROM jobs WHERE model = ? AND"
            f" state = 'done' ORDER BY finished DESC LIMIT {RECENT})"
        )
        row = connection.execute(query, (model,)).fetchone() if connection else None
        found = row or self._db.row(query, model)
        return FIRST_GUESS_S if found is None or found["mean"] is None else float(found["mean"])


def order(read: Read, model: str) -> list[str]:
    """Ids of the waiting jobs of a model in the order they will be begun.

    Parameters
    ----------
    read : callable
        ``read(query, *values)``: the rows, from a transaction or as they are now.
    model : str
    """
    query = "SELECT id, owner, ticket FROM jobs WHERE state = 'queued' AND model = ?"
    waiting = [Waiting(*row) for row in read(query, model)]
    turns = {row["owner"]: row["turn"] for row in read("SELECT * FROM served")}
    running = Counter(r["owner"] for r in read("SELECT owner FROM jobs WHERE state = 'running'"))
    return fair_order(waiting, turns, running)


def _same(job: Job, digest: str) -> Job:
    if job.digest != digest:
        raise FieldError(
            "Idempotency-Key",
            "the request this key was first used for",
            "another request",
            advice="use a new key for a new request",
        )
    return job
