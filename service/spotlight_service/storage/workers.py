"""Which workers live, and what they hold."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any, Final

from spotlight_service.storage.database import Database

__all__ = ["WorkerBook"]

LIVES_S: Final = 300.0
"""Seconds after its last note that a worker counts as gone: one step of the largest model."""


class WorkerBook:
    """Notes of workers in a database.

    Parameters
    ----------
    database : Database
    clock : callable
    """

    def __init__(self, database: Database, clock: Callable[[], float] = time.time) -> None:
        self._db, self._clock = database, clock

    def note(self, worker: str, model: str, facts: dict[str, Any]) -> None:
        """Write down that a worker is ready, and facts about it."""
        with self._db.writing() as connection:
            connection.execute(
                "INSERT OR REPLACE INTO workers VALUES (?, ?, ?, ?)",
                (worker, model, self._clock(), json.dumps(facts)),
            )

    def forget(self, worker: str | None = None) -> None:
        """Strike a worker, or all, from the book."""
        with self._db.writing() as connection:
            connection.execute("DELETE FROM workers WHERE id = ?1 OR ?1 IS NULL", (worker,))

    def living(self) -> dict[str, list[dict[str, Any]]]:
        """Facts about living workers, by model."""
        rows = self._db.rows("SELECT * FROM workers WHERE beat > ?", self._clock() - LIVES_S)
        found: dict[str, list[dict[str, Any]]] = {}
        for row in rows:
            found.setdefault(row["model"], []).append(json.loads(row["facts"]))
        return found
