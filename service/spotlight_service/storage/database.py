"""The SQLite file: one connection to read, one to write, schema and transactions."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any, Final

__all__ = ["Database"]

BUSY_S: Final = 20.0
"""Seconds a writer waits for another process's transaction, which take milliseconds."""
_VERSION: Final = 1
_SCHEMA: Final = """
CREATE TABLE IF NOT EXISTS jobs (
  id TEXT PRIMARY KEY,
  owner TEXT NOT NULL,
  model TEXT NOT NULL,
  state TEXT NOT NULL CHECK (state IN ('queued', 'running', 'done', 'failed', 'cancelled')),
  request TEXT NOT NULL,
  digest TEXT NOT NULL,
  idempotency TEXT,
  ticket INTEGER NOT NULL,
  created REAL NOT NULL,
  deadline REAL NOT NULL,
  started REAL,
  finished REAL,
  attempt INTEGER NOT NULL DEFAULT 0,
  worker TEXT,
  lease REAL,
  cancelling INTEGER NOT NULL DEFAULT 0,
  watched REAL NOT NULL DEFAULT 0,
  progress TEXT,
  plan TEXT,
  error TEXT,
  report TEXT,
  preview INTEGER NOT NULL DEFAULT 0,
  revision INTEGER NOT NULL
);
CREATE UNIQUE INDEX IF NOT EXISTS job_keys ON jobs (owner, idempotency)
  WHERE idempotency IS NOT NULL;
CREATE INDEX IF NOT EXISTS job_states ON jobs (state, ticket);
CREATE INDEX IF NOT EXISTS job_revisions ON jobs (revision);
CREATE INDEX IF NOT EXISTS job_owners ON jobs (owner, ticket);
CREATE TABLE IF NOT EXISTS served (owner TEXT PRIMARY KEY, turn INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS counters (name TEXT PRIMARY KEY, value INTEGER NOT NULL);
INSERT OR IGNORE INTO counters VALUES ('revision', 0), ('ticket', 0), ('turn', 0);
CREATE TABLE IF NOT EXISTS workers (
  id TEXT PRIMARY KEY, model TEXT NOT NULL, beat REAL NOT NULL, facts TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS scenes (
  id TEXT NOT NULL, owner TEXT NOT NULL, used REAL NOT NULL, PRIMARY KEY (id, owner)
);
CREATE TABLE IF NOT EXISTS keys (
  id TEXT PRIMARY KEY,
  name TEXT NOT NULL,
  hash TEXT NOT NULL,
  scopes TEXT NOT NULL,
  per_minute INTEGER,
  created REAL NOT NULL,
  revoked REAL
);
"""


class Database:
    """A SQLite file in write-ahead mode; safe to use from any thread.

    Readers never wait for writers: what answers requests reads without a transaction, on a
    connection of its own.

    Parameters
    ----------
    path : Path
        Made where it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self._locks = RLock(), RLock()
        self._writer = self._connect()
        with self._locks[1]:
            # NORMAL loses nothing when a process is killed; a power cut may cost the last moment.
            self._writer.execute("PRAGMA journal_mode = WAL")
            self._writer.executescript(_SCHEMA)
            self._writer.execute(f"PRAGMA user_version = {_VERSION}")
        self._reader = self._connect()

    def rows(self, query: str, *values: Any) -> list[sqlite3.Row]:
        """Everything a query finds, as it is now."""
        with self._locks[0]:
            return self._reader.execute(query, values).fetchall()

    def row(self, query: str, *values: Any) -> sqlite3.Row | None:
        """The first row a query finds."""
        with self._locks[0]:
            found: sqlite3.Row | None = self._reader.execute(query, values).fetchone()
            return found

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """A transaction, which no other process's can come between."""
        with self._locks[1]:
            self._writer.execute("BEGIN IMMEDIATE")
            try:
                yield self._writer
                self._writer.execute("COMMIT")
            except BaseException:
                if self._writer.in_transaction:  # a full disk has rolled back by itself
                    self._writer.execute("ROLLBACK")
                raise

    def close(self) -> None:
        """Close both connections."""
        for lock, connection in zip(self._locks, (self._reader, self._writer)):
            with lock:
                connection.close()

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(
            self.path, timeout=BUSY_S, isolation_level=None, check_same_thread=False
        )
        connection.row_factory = sqlite3.Row
        connection.execute("PRAGMA synchronous = NORMAL")
        return connection


def bump(connection: sqlite3.Connection, name: str) -> int:
    """The next number of a counter; inside a transaction."""
    connection.execute("UPDATE counters SET value = value + 1 WHERE name = ?", (name,))
    (value,) = connection.execute("SELECT value FROM counters WHERE name = ?", (name,)).fetchone()
    return int(value)
