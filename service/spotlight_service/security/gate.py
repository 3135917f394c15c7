"""What every request passes first and every answer last: ids, limits, headers, one log line.

Plain ASGI, so that a client that leaves is still noticed further in.
"""

from __future__ import annotations

import json
import logging
import re
import time
import uuid
from collections.abc import Callable
from typing import Any, Final

import anyio
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from spotlight_service.problems import MEDIA_TYPE, ProblemError
from spotlight_service.security.access import Access
from spotlight_service.settings import LOOPBACK, Settings

__all__ = ["HEADERS", "Gate"]

log = logging.getLogger("spotlight_service.requests")

HEADERS: Final = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; font-src 'self'; manifest-src 'self'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
}
_REQUEST_ID: Final = re.compile(r"[A-Za-z0-9._-]{1,64}")
_LOGGED: Final = 300
"""Characters of a path that the log repeats."""
_UPLOADS: Final = "/v1/scenes"
_HOST: Final = re.compile(r"(?P<name>\[[0-9a-fA-F:]+\]|[^:]*)(:\d+)?")
Counted = Callable[[str, str, int, float], None]


class Gate:
    """The outermost layer.

    Parameters
    ----------
    app : ASGI application
    settings : Settings
    access : Access
        Where callers need no key, only pages of this very service may call: a web page elsewhere
        must not use the visitor's machine.
    counted : callable
        Told ``(method, route, status, seconds)`` of every answer.
    """

    def __init__(self, app: ASGIApp, settings: Settings, access: Access, counted: Counted) -> None:
        self._app, self._settings = app, settings
        self._access, self._counted = access, counted

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {
            name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]
        }
        given = headers.get("x-request-id", "")
        request = given if _REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
        scope.setdefault("state", {})["request"] = request
        began, status = time.perf_counter(), 500

        async def sending(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                own = {name for name, _ in message["headers"]}
                extra = {**HEADERS, "x-request-id": request}
                private = scope["path"].startswith(("/v1", "/v2", "/metrics"))
                # The page is asked for anew each time: an old script knows no new service.
                extra["cache-control"] = "no-store" if private else "no-cache"
                message["headers"] = [
                    *message["headers"],
                    *((k.encode(), v.encode()) for k, v in extra.items() if k.encode() not in own),
                ]
            await send(message)

        try:
            self._check_origin(headers)
            caller = self._access.admit(scope["method"], scope["path"], headers)
            scope["state"]["caller"] = caller
            limit = self._limit(scope, headers)
            await self._app(scope, self._bounded(receive, limit), sending)
        except ProblemError as problem:
            await refuse(problem, request, sending)
        finally:
            seconds = time.perf_counter() - began
            route = getattr(scope.get("route"), "path", "elsewhere")
            self._counted(scope["method"], route, status, seconds)
            log.info(
                "%s %s",
                scope["method"][:_LOGGED],
                scope["path"][:_LOGGED],
                extra={
                    "request": request,
                    "status": status,
                    "seconds": round(seconds, 4),
                    "caller": getattr(scope["state"].get("caller"), "id", None),
                },
            )

    def _check_origin(self, headers: dict[str, str]) -> None:
        """Refuse calls of web pages elsewhere, and of names that were made to point here."""
        if self._access.needs_keys() or self._settings.insecure_open:
            return
        host = headers.get("host", "")
        found = _HOST.fullmatch(host)
        name = "" if found is None else found["name"].strip("[]")
        if name not in LOOPBACK:
            raise ProblemError(
                421,
                "Host: expected this machine's loopback address, as the service has no API keys",
                [{"field": "Host", "expected": ", ".join(LOOPBACK), "got": host[:100]}],
            )
        origin = headers.get("origin")
        if origin is not None and origin.removeprefix("http://") != host:
            raise ProblemError(
                403,
                "Origin: expected this service's own page, as it has no API keys",
                [{"field": "Origin", "expected": f"http://{host}", "got": origin[:100]}],
            )

    def _limit(self, scope: Scope, headers: dict[str, str]) -> int:
        uploads = scope["path"].rstrip("/") == _UPLOADS
        limit = self._settings.max_upload_bytes if uploads else self._settings.max_json_bytes
        told = headers.get("content-length", "0")
        if told.isdigit() and int(told) > limit:
            raise too_large(limit, told)
        return limit

    def _bounded(self, receive: Receive, limit: int) -> Receive:
        """`receive`, but no more than so many bytes and no longer than allowed."""
        taken, complete = 0, False
        until = time.monotonic() + self._settings.upload_s

        async def receiving() -> Message:
            nonlocal taken, complete
            if complete:  # what comes now is news of the client leaving
                return await receive()
            message = await within(receive, until - time.monotonic())
            if message["type"] == "http.request":
                taken += len(message.get("body", b""))
                complete = not message.get("more_body", False)
                if taken > limit:
                    # As an HTTPException it passes through the form parser unharmed.
                    raise HTTPException(413, too_large(limit, f"{taken} or more").detail)
            return message

        return receiving


async def within(receive: Receive, seconds: float) -> Message:
    """The next message, if it comes in time."""
    with anyio.move_on_after(max(0.0, seconds)):
        return await receive()
    raise HTTPException(408, "body: took too long to arrive")


def too_large(limit: int, got: str) -> ProblemError:
    """A body of too many bytes."""
    told = [{"field": "body", "expected": f"at most {limit} bytes", "got": got[:40]}]
    return ProblemError(413, f"body: expected at most {limit} bytes, got {got[:40]}", told)


async def refuse(problem: ProblemError, request: str, send: Send) -> None:
    """Answer with a problem, outside of any framework."""
    document: dict[str, Any] = {**problem.document(), "request": request}
    body = json.dumps(document).encode()
    headers = {"content-type": MEDIA_TYPE, "content-length": str(len(body)), **problem.headers}
    start = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": problem.status, "headers": start})
    await send({"type": "http.response.body", "body": body})
