"""Errors as RFC 9457 problem details: each names the field, what was expected and what came.

::

    {"type": "about:blank", "title": "Unprocessable Content", "status": 422,
     "detail": "elevation: expected a finite number from -90 to 90, got 120",
     "errors": [{"field": "lights[0].elevation", "expected": "…", "got": "120"}],
     "request": "2f6c…"}
"""

from __future__ import annotations

import errno
import re
import sqlite3
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, Final

from spotlight_runtime.errors import ModelError, NumericalError, SpotLightError

__all__ = ["MEDIA_TYPE", "FieldError", "ProblemError", "disk_is_full", "of_error", "of_validation"]

MEDIA_TYPE: Final = "application/problem+json"
_SHOWN: Final = 200
"""Characters of a value that an error repeats."""
_FULL: Final = {errno.ENOSPC, errno.EDQUOT}
_MESSAGE: Final = re.compile(
    r"(?P<field>[^:]{1,160}): .*?expected (?P<expected>.+?), (?:got|found) (?P<got>[^;]+)", re.S
)


class ProblemError(Exception):
    """An answer that is an error.

    Parameters
    ----------
    status : int
    detail : str
        For a person: what is wrong and how to put it right.
    errors : sequence of dict
        Each with ``field``, ``expected`` and ``got``.
    headers : mapping, optional
    **more
        Further members of the document.
    """

    def __init__(
        self,
        status: int,
        detail: str,
        errors: Sequence[Mapping[str, str]] = (),
        headers: Mapping[str, str] | None = None,
        **more: Any,
    ) -> None:
        super().__init__(detail)
        self.status, self.detail, self.headers = int(status), detail, dict(headers or {})
        self.errors, self.more = [dict(each) for each in errors], more

    def document(self) -> dict[str, Any]:
        """The problem as JSON."""
        title = HTTPStatus(self.status).phrase
        body = {"type": "about:blank", "title": title, "status": self.status, "detail": self.detail}
        return {**body, "errors": self.errors, **self.more}


class FieldError(ProblemError):
    """One field that is wrong."""

    def __init__(
        self, field: str, expected: str, got: Any, *, status: int = 422, advice: str = ""
    ) -> None:
        shown = str(got)[:_SHOWN]
        detail = f"{field}: expected {expected}, got {shown}" + (f"; {advice}" if advice else "")
        super().__init__(status, detail, [{"field": field, "expected": expected, "got": shown}])


def of_validation(errors: Sequence[Mapping[str, Any]]) -> ProblemError:
    """What FastAPI says of a request that does not match its schema."""
    told = []
    for error in errors:
        place, *inner = error["loc"]
        name = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in inner).lstrip(".")
        got = "nothing" if error["type"] == "missing" else repr(error.get("input"))
        expected = "a value" if error["type"] == "missing" else error["msg"]
        told.append({"field": name or str(place), "expected": expected, "got": got[:_SHOWN]})
    first = told[0]
    detail = f"{first['field']}: expected {first['expected']}, got {first['got']}"
    status = 400 if errors[0]["type"] == "json_invalid" else 422
    return ProblemError(status, detail, told)


def of_error(error: Exception, hide: Sequence[str] = ()) -> ProblemError:
    """What the runtime, the disk or the database complain about.

    Parameters
    ----------
    error : Exception
    hide : sequence of str
        Paths of this machine that are not for others to see.

    Returns
    -------
    ProblemError
        Status 422 for what the caller can change, 507 for a full disk, 500 otherwise.
    """
    if isinstance(error, ProblemError):
        return error
    if disk_is_full(error):
        return ProblemError(
            507, "the disk is full: nothing was stored; free some space and try again"
        )
    if isinstance(error, MemoryError):
        return ProblemError(
            413, "this takes more memory than the service allows; send a smaller one"
        )
    if not isinstance(error, SpotLightError):
        return ProblemError(500, "internal error; the log has it under this request's id")
    text = " ".join(str(error).split())
    for path in hide:
        text = text.replace(f"{path}/", "").replace(path, "the scene")
    found = _MESSAGE.match(text)
    named = [] if found is None else [{k: v[:_SHOWN] for k, v in found.groupdict().items()}]
    status = 500 if isinstance(error, NumericalError | ModelError) else 422
    return ProblemError(status, text, named)


def disk_is_full(error: BaseException) -> bool:
    """Whether that is what an error means, wherever in the chain of causes it stands."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _FULL:
            return True
        if isinstance(cause, sqlite3.OperationalError):
            code = getattr(cause, "sqlite_errorcode", None)
            if code is not None and code & 0xFF == sqlite3.SQLITE_FULL:
                return True
        cause = cause.__cause__ or cause.__context__
    return False
