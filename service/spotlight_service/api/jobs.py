"""Relights as jobs: made, looked at, watched, fetched, cancelled."""

from __future__ import annotations

import asyncio
import re
from typing import Annotated, Any, Final

import anyio
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse
from sse_starlette import EventSourceResponse

from spotlight_service.api.common import (
    JSON,
    CallerHere,
    Here,
    JobId,
    asked,
    own_job,
    problems,
    takes,
)
from spotlight_service.api.events import job_events
from spotlight_service.problems import FieldError, ProblemError
from spotlight_service.schemas import MOST_LIGHTS, RelightRequest
from spotlight_service.serving import Service
from spotlight_service.storage.records import Job
from spotlight_service.submission import submit
from spotlight_service.views import JobList, JobView, job_view

__all__ = ["router"]

router = APIRouter(prefix="/v1", tags=["jobs"])

FORMATS: Final = {
    "image/png": ".png",
    "image/jpeg": ".jpg",
    "image/webp": ".webp",
    "image/x-exr": ".exr",
}
PICTURE: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "description": "The picture.",
        "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in FORMATS},
        "headers": {
            "Spotlight-Request": {
                "description": "SHA-256 of the request it was made for.",
                "schema": {"type": "string"},
            }
        },
    }
}
_WAIT: Final = re.compile(r"(?:^|[,;\s])wait\s*=\s*(\d{1,6})")
_DISCONNECT_S: Final = 0.25
"""Between two looks whether a waiting client is still there."""
_PARTING_S: Final = 5.0
"""Seconds that streams have to end by themselves at shutdown."""


@router.post(
    "/relight",
    status_code=202,
    response_model=JobView,
    dependencies=[takes(JSON)],
    responses={**problems(406, 415, 504, 507), **PICTURE},
    summary="Relight a scene",
)
async def relight(
    request: Request,
    body: RelightRequest,
    service: Here,
    caller: CallerHere,
    prefer: Annotated[
        str | None,
        Header(max_length=200, description="`wait=N`: answer with the picture if N seconds do."),
    ] = None,
    accept: Annotated[str | None, Header(max_length=500)] = None,
    idempotency_key: Annotated[
        str | None,
        Header(min_length=1, max_length=200, description="Makes the same request only once."),
    ] = None,
) -> Response:
    """Make a job, answered 202 with its place; or wait for the picture with ``Prefer: wait=N``.

    A client that leaves while it waits cancels the job it made.
    """
    wait = _wait(prefer, service.settings.longest_wait_s)
    # JSON is what jobs are told in, and what curl --json asks for: no wish for a kind of picture.
    silent = not wait or (accept or "").strip().lower() == JSON
    suffix = ".png" if silent else _suffix(accept)
    made = await submit(service, caller, body, idempotency_key)
    job = made.job
    headers = {} if made.created else {"Idempotency-Replayed": "true"}
    if wait:
        headers["Preference-Applied"] = f"wait={wait}"
        job = await _waited(request, service, job, wait, cancels=made.created)
        if job.state == "done":
            return await _picture(service, job, suffix, headers)
        if job.state == "failed" and job.error is not None:
            error = job.error
            status = error["status"] if error["status"] in (413, 422, 504, 507) else 500
            raise ProblemError(status, error["detail"], error["errors"], headers)
    headers["Location"] = f"/v1/jobs/{job.id}"
    view = job_view(job, service.jobs).model_dump(mode="json")
    return JSONResponse(view, status_code=202, headers=headers)


@router.get("/jobs", response_model=JobList, responses=problems())
async def list_jobs(
    service: Here, caller: CallerHere, limit: Annotated[int, Query(ge=1, le=200)] = 50
) -> JobList:
    """Your jobs, newest first."""
    jobs = service.jobs.latest(caller.id, limit)
    return JobList(jobs=[job_view(job, service.jobs) for job in jobs])


@router.get("/jobs/{job}", response_model=JobView, responses=problems())
async def get_job(job: JobId, service: Here, caller: CallerHere) -> JobView:
    """A job of yours: state, place in the queue, progress, seconds left."""
    return job_view(own_job(service, caller, job), service.jobs)


@router.delete("/jobs/{job}", response_model=JobView, responses=problems(507))
async def cancel_job(job: JobId, service: Here, caller: CallerHere) -> JobView:
    """Cancel a job of yours: at once while it waits, at the end of its step while it runs.

    One that has ended stays as it is.
    """
    own_job(service, caller, job)
    found = await asyncio.to_thread(service.jobs.cancel, job, caller.id)
    return job_view(found or own_job(service, caller, job), service.jobs)


@router.get(
    "/jobs/{job}/result", response_class=Response, responses={**problems(406, 409), **PICTURE}
)
async def get_result(
    job: JobId,
    service: Here,
    caller: CallerHere,
    accept: Annotated[
        str | None, Header(max_length=500, description="PNG, JPEG, WebP, or EXR (linear).")
    ] = None,
    light: Annotated[
        int | None,
        Query(ge=0, lt=MOST_LIGHTS, description="Of a sweep: this light's picture, not the sheet."),
    ] = None,
) -> Response:
    """The picture of a job of yours that is done."""
    suffix = _suffix(accept)
    found = own_job(service, caller, job)
    _done(found)
    if light is not None and not service.files.picture(job, light).is_file():
        known = f"0 to {len(found.request['lights']) - 1}" if found.request["sweep"] else "none"
        raise FieldError("light", known, str(light), status=404)
    return await _picture(service, found, suffix, {}, light)


@router.get("/jobs/{job}/report", response_model=dict[str, Any], responses=problems(409))
async def get_report(job: JobId, service: Here, caller: CallerHere) -> dict[str, Any]:
    """How a picture came about: options, plan, seconds by stage, model."""
    found = own_job(service, caller, job)
    _done(found)
    return found.report or {}


@router.get(
    "/jobs/{job}/events",
    response_class=EventSourceResponse,
    responses={
        **problems(),
        200: {
            "description": "Server-sent events: `state`, `progress`, `preview`, and one of `done`, "
            "`failed`, `cancelled`, after which the stream ends.",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
    },
)
async def watch_job(job: JobId, service: Here, caller: CallerHere) -> EventSourceResponse:
    """Watch a job of yours.

    ``state``, ``done``, ``failed`` and ``cancelled`` carry the whole job, ``progress`` how far it
    is and the seconds left, ``preview`` the picture as it forms (a data: URL). Whoever comes
    later, or again, is told where things stand and goes on from there.
    """
    found = own_job(service, caller, job)
    return EventSourceResponse(
        job_events(service, found),
        ping=service.settings.keep_alive_s,
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
        shutdown_event=anyio.Event(),  # never asked: the broker ends streams
        shutdown_grace_period=_PARTING_S,
    )


async def _waited(
    request: Request, service: Service, job: Job, seconds: float, *, cancels: bool
) -> Job:
    """The job when it has ended, or when the time is over; cancelled if the client has left."""
    waiting = asyncio.create_task(service.broker.final(job, seconds))
    try:
        while not waiting.done():
            await asyncio.wait({waiting}, timeout=_DISCONNECT_S)
            if not waiting.done() and cancels and await request.is_disconnected():
                await asyncio.to_thread(service.jobs.cancel, job.id, job.owner)
                break
    except asyncio.CancelledError:
        if cancels:
            service.jobs.cancel(job.id, job.owner)
        raise
    finally:
        if not waiting.done():
            waiting.cancel()
    return waiting.result() if waiting.done() and not waiting.cancelled() else job


async def _picture(
    service: Service, job: Job, suffix: str, headers: dict[str, str], light: int | None = None
) -> Response:
    kind = next(kind for kind, s in FORMATS.items() if s == suffix)
    query, part = ("", "") if light is None else (f"?light={light}", f"-{light}")
    headers = {
        **headers,
        "Spotlight-Request": job.digest,
        "Spotlight-Job": job.id,
        "Content-Location": f"/v1/jobs/{job.id}/result{query}",
        "Content-Disposition": f'inline; filename="spotlight-{job.id[:8]}{part}{suffix}"',
        "Vary": "Accept",
    }
    path = service.files.picture(job.id, light)
    if suffix == ".png":
        return FileResponse(path, media_type=kind, headers=headers)
    pixels = str(service.files.pixels(job.id, light))
    _, data = await asked(
        service.sketches, "convert", picture=str(path), pixels=pixels, suffix=suffix
    )
    return Response(data, media_type=kind, headers=headers)


def _done(job: Job) -> None:
    if job.state != "done":
        raise FieldError("job", "one that is done", job.state, status=409)


def _wait(prefer: str | None, longest: float) -> float:
    found = _WAIT.search(prefer or "")
    return 0.0 if found is None else min(float(found[1]), longest)


def _suffix(accept: str | None) -> str:
    """The format a client likes best of those there are; PNG where it has no preference."""
    if not accept or not accept.strip():
        return ".png"
    liked: dict[str, float] = {}
    for entry in accept.split(","):
        kind, *parameters = (part.strip().lower() for part in entry.split(";"))
        weights = [p[2:] for p in parameters if p.startswith("q=")]
        try:
            liked[kind] = float(weights[0]) if weights else 1.0
        except ValueError:
            liked[kind] = 0.0
    best, found = 0.0, None
    for kind, suffix in FORMATS.items():
        weight = liked.get(kind, liked.get("image/*", liked.get("*/*", 0.0)))
        if weight > best:
            best, found = weight, suffix
    if found is None:
        raise FieldError("Accept", " or ".join(FORMATS), accept, status=406)
    return found
