"""Everything that can go wrong here, one class a cause.

::

    BenchError
    ├── DataError (ValueError)       a test set that cannot be evaluated on
    ├── MethodError (ValueError)     an unknown method, or a folder that lacks its pictures
    └── ResultsError (ValueError)    results on disk that do not belong to this run
"""

from __future__ import annotations

__all__ = ["BenchError", "DataError", "MethodError", "ResultsError"]


class BenchError(Exception):
    """Base of every error this package raises on purpose."""


class DataError(BenchError, ValueError):
    """A test set lacks what an evaluation needs."""


class MethodError(BenchError, ValueError):
    """A method is unknown, named twice, or its folder lacks a picture."""


class ResultsError(BenchError, ValueError):
    """Results on disk are damaged or of another run."""
