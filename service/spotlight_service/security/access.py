"""Who a request is from and whether it may be made; decided before a byte of its body is read."""

from __future__ import annotations

from collections.abc import Mapping

from spotlight_service.problems import ProblemError
from spotlight_service.security.keys import LOCAL, Caller, KeyStore
from spotlight_service.security.rates import RateLimiter

__all__ = ["Access", "scope_of"]


def scope_of(method: str, path: str) -> str | None:
    """The scope a request needs; None where everybody may make it."""
    if path == "/metrics":
        return "metrics"
    if path.startswith("/v2/health/") or not path.startswith(("/v1/", "/v2")):
        return None  # the page itself, its documentation, and whether the service lives
    return "read" if method in ("GET", "HEAD", "OPTIONS") else "write"


class Access:
    """Keys and rates together.

    Parameters
    ----------
    keys : KeyStore
    rates : RateLimiter
    """

    def __init__(self, keys: KeyStore, rates: RateLimiter) -> None:
        self._keys, self._rates = keys, rates

    def needs_keys(self) -> bool:
        """Whether callers have to show a key."""
        return self._keys.any()

    def admit(self, method: str, path: str, headers: Mapping[str, str]) -> Caller | None:
        """Who calls; None for what everybody may see.

        Raises
        ------
        ProblemError
            401 without a valid key, 403 without the scope, 429 for one request too many.
        """
        scope = scope_of(method, path)
        if scope is None:
            return None
        caller = self._caller(headers) if self.needs_keys() else LOCAL
        if scope not in caller.scopes:
            raise ProblemError(
                403,
                f"Authorization: expected a key with the scope {scope!r}",
                [{"field": "Authorization", "expected": scope, "got": " ".join(caller.scopes)}],
            )
        self._rates.take(caller.id, caller.per_minute)
        return caller

    def _caller(self, headers: Mapping[str, str]) -> Caller:
        kind, _, token = headers.get("authorization", "").partition(" ")
        if kind.lower() != "bearer":
            token = headers.get("x-api-key", "")
        caller = self._keys.check(token.strip()) if token else None
        if caller is None:
            got = "one that is not valid here" if token else "nothing"
            raise ProblemError(
                401,
                f"Authorization: expected Bearer and an API key, got {got}",
                [{"field": "Authorization", "expected": "Bearer and an API key", "got": got}],
                {"WWW-Authenticate": "Bearer"},
            )
        return caller
