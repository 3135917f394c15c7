"""The job store as workers see it: claim, give signs of life, finish.

A worker's word counts only as long as the job is the attempt it claimed, so a job that was given to
another worker finishes once, whoever comes first.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Callable
from typing import Any, Final, Literal

from spotlight_service.problems import ProblemError
from spotlight_service.storage.database import Database, bump
from spotlight_service.storage.jobs import order
from spotlight_service.storage.records import Claim, State, job_of

__all__ = ["Verdict", "WorkQueue"]

Verdict = Literal["go on", "cancel", "deadline", "lost"]
"""What a worker is to do with its job: end it in one way or the other, or let go of it at once."""
_MINE: Final = "id = ? AND state = 'running' AND worker = ? AND attempt = ?"


class WorkQueue:
    """The waiting and running jobs of a database.

    Parameters
    ----------
    database : Database
    lease : float
        Seconds after its last sign of life that a running job goes back to the queue.
    attempts : int
        Times a job may be begun.
    clock : callable
        Seconds since 1970.
    """

    def __init__(
        self,
        database: Database,
        *,
        lease: float = 15.0,
        attempts: int = 3,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._db, self._clock = database, clock
        self._lease, self._attempts = lease, attempts

    def claim(self, worker: str, model: str) -> Claim | None:
        """Begin the job whose turn it is.

        Jobs that nobody has given a sign of life of go back to the queue before, and those past
        their deadline fail.
        """
        now = self._clock()
        if not self._anything(now, model):  # without a transaction: workers ask many times a second
            return None
        with self._db.writing() as connection:
            self._sweep(connection, now)
            line = order(lambda q, *v: connection.execute(q, v).fetchall(), model)
            if not line:
                return None
            connection.execute(
                "UPDATE jobs SET state = 'running', attempt = attempt + 1, worker = ?, lease = ?,"
                " started = ?, progress = NULL, revision = ? WHERE id = ?",
                (worker, now + self._lease, now, bump(connection, "revision"), line[0]),
            )
            row = connection.execute("SELECT * FROM jobs WHERE id = ?", (line[0],)).fetchone()
            connection.execute(
                "INSERT INTO served VALUES (?, ?) ON CONFLICT (owner) DO UPDATE SET turn = ?2",
                (row["owner"], bump(connection, "turn")),
            )
        return Claim(job_of(row), worker)

    def verdict(self, claim: Claim) -> Verdict:
        """Whether a worker is to go on with its job."""
        row = self._mine(claim)
        if row is None:
            return "lost"
        if row["cancelling"]:
            return "cancel"
        return "deadline" if self._clock() > row["deadline"] else "go on"

    def watched(self, claim: Claim) -> bool:
        """Whether anybody looks at this job's events."""
        row = self._mine(claim)
        return row is not None and row["watched"] > self._clock()

    def beat(self, claim: Claim) -> bool:
        """Give a sign of life; False if the job is no longer this worker's."""
        with self._db.writing() as connection:
            done = connection.execute(
                f"UPDATE jobs SET lease = ? WHERE {_MINE}",
                (self._clock() + self._lease, *_key(claim)),
            )
        return done.rowcount == 1

    def tell(self, claim: Claim, **facts: Any) -> None:
        """Write down progress (``progress``, ``plan`` or ``preview``) of a job."""
        sets = ", ".join(f"{name} = ?" for name in facts)
        values = [json.dumps(v) if isinstance(v, dict) else v for v in facts.values()]
        with self._db.writing() as connection:
            connection.execute(
                f"UPDATE jobs SET {sets}, lease = ?, revision = ? WHERE {_MINE}",
                (*values, self._clock() + self._lease, bump(connection, "revision"), *_key(claim)),
            )

    def finish(
        self,
        claim: Claim,
        state: State,
        *,
        report: dict[str, Any] | None = None,
        error: dict[str, Any] | None = None,
    ) -> bool:
        """End a job; False if it was no longer this worker's to end."""
        with self._db.writing() as connection:
            done = connection.execute(
                "UPDATE jobs SET state = ?, finished = ?, report = ?, error = ?, lease = NULL,"
                f" revision = ? WHERE {_MINE}",
                (
                    *(state, self._clock(), _json(report), _json(error)),
                    *(bump(connection, "revision"), *_key(claim)),
                ),
            )
        return done.rowcount == 1

    def release(self, claim: Claim) -> None:
        """Give a job back to the queue, as if it had never been begun."""
        with self._db.writing() as connection:
            connection.execute(
                "UPDATE jobs SET state = 'queued', attempt = attempt - 1, lease = NULL,"
                f" progress = NULL, revision = ? WHERE {_MINE}",
                (bump(connection, "revision"), *_key(claim)),
            )

    def abandon(self, worker: str | None = None) -> int:
        """Take the jobs of a dead worker, or of all, back; returns how many there were."""
        with self._db.writing() as connection:
            return self._requeue(connection, "worker = ?1 OR ?1 IS NULL", worker)

    def sweep(self) -> None:
        """Do what `claim` does first, where nobody claims."""
        with self._db.writing() as connection:
            self._sweep(connection, self._clock())

    def _mine(self, claim: Claim) -> sqlite3.Row | None:
        return self._db.row(f"SELECT * FROM jobs WHERE {_MINE}", *_key(claim))

    def _sweep(self, connection: sqlite3.Connection, now: float) -> None:
        late = ProblemError(504, "deadline_s: the job was not begun before its deadline").document()
        connection.execute(
            "UPDATE jobs SET state = 'failed', finished = ?1, error = ?2, revision = ?3"
            " WHERE state = 'queued' AND deadline < ?1",
            (now, json.dumps(late), bump(connection, "revision")),
        )
        self._requeue(connection, "lease < ?1", now)

    def _requeue(self, connection: sqlite3.Connection, which: str, value: Any) -> int:
        """Back to the queue; who has asked for it is cancelled, who was begun too often fails."""
        deadly = ProblemError(500, f"begun {self._attempts} times, its worker died each time")
        moved = connection.execute(
            "UPDATE jobs SET lease = NULL, progress = NULL, revision = ?2,"
            " state = CASE WHEN cancelling THEN 'cancelled' WHEN attempt >= ?3 THEN 'failed'"
            " ELSE 'queued' END,"
            " finished = iif(cancelling OR attempt >= ?3, ?4, NULL),"
            " error = iif(attempt >= ?3 AND NOT cancelling, ?5, NULL)"
            f" WHERE state = 'running' AND ({which})",
            (
                *(value, bump(connection, "revision"), self._attempts, self._clock()),
                json.dumps(deadly.document()),
            ),
        )
        return moved.rowcount

    def _anything(self, now: float, model: str) -> bool:
        query = (
            "SELECT 1 FROM jobs WHERE (state = 'queued' AND model = ?)"
            " OR (state = 'running' AND lease < ?) LIMIT 1"
        )
        return self._db.row(query, model, now) is not None


def _key(claim: Claim) -> tuple[str, str, int]:
    return claim.job.id, claim.worker, claim.job.attempt


def _json(value: dict[str, Any] | None) -> str | None:
    return None if value is None else json.dumps(value)
