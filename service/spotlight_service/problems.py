"""Errors as RFC 9457 problem details: each names the field, what was expected and what came.

::

    {"type": "about:blank", "title": "Unprocessable Content", "status": 422,
     "detail": "lights[0].elevation: expected a number of at most 90, got 120",
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

__all__ = [
    "MEDIA_TYPE",
    "TAG",
    "FieldError",
    "ProblemError",
    "disk_is_full",
    "fields_in",
    "of_error",
    "of_validation",
]

MEDIA_TYPE: Final = "application/problem+json"
TAG: Final = "~"
"""What tags of unions begin with: pydantic puts them among the fields, whose names they are not."""
_SHOWN: Final = 200
"""Characters of a value that an error repeats."""
_FULL: Final = {errno.ENOSPC, errno.EDQUOT}
_MESSAGE: Final = re.compile(
    r"(?P<field>[^:]{1,160}): .*?expected (?P<expected>.+?), (?:got|found) (?P<got>[^;]+)", re.S
)
_DIGITS: Final = re.compile(r"\^\[0-9a-f\]\{(\d+)\}\$")
"""The pattern of an id."""
_EXPECTED: Final = {
    "extra_forbidden": "no field of this name",
    "finite_number": "a finite number",
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number of at least {ge}",
    "json_invalid": "JSON",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number of at most {le}",
    "literal_error": "{expected}",
    "missing": "a value",
    "string_pattern_mismatch": "{pattern}",
    "string_too_long": "text of at most {max_length} characters",
    "string_too_short": "text of at least {min_length} characters",
    "too_long": "a list of at most {max_length}",
    "too_short": "a list of at least {min_length}",
    "value_error": "a file",  # FastAPI's, of a form: no check of our own raises one
    # Of what type a value has to be, whatever keeps it from being one:
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "list": "a list",
    "model": "a JSON object",
    "string": "text",
    "tuple": "a list",
}
"""What pydantic's errors say was expected, by their type or its first word."""


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
    """What pydantic says of a request, or of settings, that do not match their schema."""
    told = [_told(error) for error in errors]
    first = told[0]
    detail = f"{first['field']}: expected {first['expected']}, got {first['got']}"
    status = 400 if errors[0]["type"] == "json_invalid" else 422
    return ProblemError(status, detail, told)


def _told(error: Mapping[str, Any]) -> dict[str, str]:
    kind, context = error["type"], error.get("ctx", {})
    place, *inner = error["loc"]
    got = repr(error.get("input"))
    if kind == "missing":
        got = "nothing"
    elif kind == "json_invalid":
        got = f"text that is none ({context['error']}, character {inner.pop()})"
    parts = [part for part in inner if not str(part).startswith(TAG)]
    name = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in parts).lstrip(".")
    words = _EXPECTED.get(kind) or _EXPECTED.get(kind.partition("_")[0])
    if words is None:
        expected = error["msg"].removeprefix("Input should be ")
    else:
        limits = {k: f"{v:g}" if isinstance(v, float) else v for k, v in context.items()}
        expected = _DIGITS.sub(r"\1 hexadecimal digits", words.format(**limits))
    return {"field": name or str(place), "expected": expected, "got": got[:_SHOWN]}


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
    status = 500 if isinstance(error, NumericalError | ModelError) else 422
    return ProblemError(status, text, fields_in(text))


def fields_in(text: str) -> list[dict[str, str]]:
    """The field, what was expected and what came, where a message says them."""
    found = _MESSAGE.match(text)
    return [] if found is None else [{k: v[:_SHOWN] for k, v in found.groupdict().items()}]


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
