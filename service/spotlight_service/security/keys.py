"""API keys: what is stored cannot be turned back into a key."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from spotlight_service.problems import FieldError
from spotlight_service.storage.database import Database

__all__ = ["LOCAL", "SCOPES", "Caller", "KeyStore"]

SCOPES: Final = {
    "read": "look at scenes, jobs and results of one's own",
    "write": "send scenes, make and cancel jobs",
    "metrics": "read /metrics, which is about everybody",
}
PREFIX: Final = "spotlight"
_SECRET_BYTES: Final = 32


@dataclass(frozen=True, slots=True)
class Caller:
    """Who makes a request.

    Attributes
    ----------
    id : str
        Owns what it makes.
    name : str
    scopes : frozenset of str
    per_minute : int, optional
        Requests; None: as many as the service usually allows.
    """

    id: str
    name: str
    scopes: frozenset[str]
    per_minute: int | None = None


LOCAL: Final = Caller("local", "whoever is at this machine", frozenset(SCOPES))
"""Who calls where no key is configured."""


class KeyStore:
    """Keys in a database.

    Parameters
    ----------
    database : Database
    clock : callable
    """

    def __init__(self, database: Database, clock: Callable[[], float] = time.time) -> None:
        self._db, self._clock = database, clock

    def create(
        self, name: str, scopes: Sequence[str] = ("read", "write"), per_minute: int | None = None
    ) -> str:
        """Make a key and return it; it cannot be had again.

        Raises
        ------
        FieldError
            If a scope is unknown.
        """
        unknown = sorted(set(scopes) - set(SCOPES))
        if unknown:
            raise FieldError("scope", f"some of {', '.join(SCOPES)}", unknown[0])
        key, secret = secrets.token_hex(6), secrets.token_urlsafe(_SECRET_BYTES)
        with self._db.writing() as connection:
            connection.execute(
                "INSERT INTO keys VALUES (?, ?, ?, ?, ?, ?, NULL)",
                (key, name, _hash(secret), " ".join(scopes), per_minute, self._clock()),
            )
        return f"{PREFIX}_{key}_{secret}"

    def check(self, token: str) -> Caller | None:
        """Whose key this is; None where it is nobody's."""
        prefix, _, rest = token.partition("_")
        key, _, secret = rest.partition("_")
        row = self._db.row("SELECT * FROM keys WHERE id = ? AND revoked IS NULL", key)
        stored = "" if row is None else row["hash"]
        if prefix != PREFIX or not hmac.compare_digest(stored, _hash(secret)) or row is None:
            return None
        scopes = frozenset(row["scopes"].split())
        return Caller(row["id"], row["name"], scopes, row["per_minute"])

    def any(self) -> bool:
        """Whether there ever was a key, so that one is needed: revoking the last opens nothing."""
        return self._db.row("SELECT 1 FROM keys LIMIT 1") is not None

    def listed(self) -> list[dict[str, object]]:
        """All keys, without what would open anything."""
        query = "SELECT id, name, scopes, per_minute, created, revoked FROM keys ORDER BY created"
        return [dict(row) for row in self._db.rows(query)]

    def revoke(self, key: str) -> bool:
        """Make a key void; False if there was none."""
        with self._db.writing() as connection:
            done = connection.execute(
                "UPDATE keys SET revoked = ? WHERE id = ? AND revoked IS NULL", (self._clock(), key)
            )
        return done.rowcount == 1


def _hash(secret: str) -> str:
    # Fast on purpose: the secret is 256 random bits, which no dictionary holds; slow hashes
    # protect passwords people make up, and would let anybody keep the service busy.
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()
