"""Requests per minute, by caller: a bucket that fills evenly."""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from spotlight_service.problems import ProblemError

__all__ = ["RateLimiter"]

MOST_CALLERS: Final = 10_000


class RateLimiter:
    """Counts requests.

    Parameters
    ----------
    per_minute : int
        Of a caller whose key says nothing else; a whole minute's worth may come at once.
    clock : callable
        Seconds that never go back.
    """

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._usual, self._clock = per_minute, clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, caller: str, per_minute: int | None = None) -> None:
        """Count one request.

        Raises
        ------
        ProblemError
            429 with Retry-After, if it is one too many.
        """
        most = self._usual if per_minute is None else per_minute
        now = self._clock()
        left, then = self._buckets.get(caller, (float(most), now))
        left = min(float(most), left + (now - then) * most / 60.0)
        if left < 1.0:
            wait = max(1, math.ceil((1.0 - left) * 60.0 / most))
            raise ProblemError(
                429,
                f"rate: expected at most {most} requests a minute; try again in {wait} s",
                [{"field": "rate", "expected": f"at most {most} a minute", "got": "more"}],
                {"Retry-After": str(wait)},
            )
        self._buckets[caller] = (left - 1.0, now)
        self._buckets.move_to_end(caller)
        while len(self._buckets) > MOST_CALLERS:
            self._buckets.popitem(last=False)
