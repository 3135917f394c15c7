"""What happens to a job, as server-sent events."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any, Final

from sse_starlette import ServerSentEvent

from spotlight_service.serving import Service
from spotlight_service.storage.records import Job
from spotlight_service.views import job_view

__all__ = ["job_events"]

_WATCH_S: Final = 4.0
"""Between two notes that somebody watches a job."""


async def job_events(service: Service, job: Job) -> AsyncIterator[ServerSentEvent]:
    """Events of a job from where it stands to its end."""
    service.metrics.streaming(1)
    told: tuple[str, int | None] = ("", None)
    shown = revision = 0
    loop = asyncio.get_running_loop()
    noted = -_WATCH_S
    try:
        async with service.broker.news(job.id) as news:
            latest: Job | None = service.jobs.get(job.id, job.owner)
            while latest is not None:
                if latest.final:
                    yield _event(service, latest, latest.state)
                    return
                place = service.jobs.position(latest) if latest.state == "queued" else None
                if (latest.state, place) != told:
                    told = (latest.state, place)
                    yield _event(service, latest, "state")
                if latest.progress and latest.revision > revision:
                    yield _event(service, latest, "progress")
                if latest.preview > shown:
                    shown = latest.preview
                    if (look := _look(service, latest)) is not None:
                        yield look
                revision = latest.revision
                if loop.time() - noted > _WATCH_S:
                    await asyncio.to_thread(service.jobs.watch, job.id)
                    noted = loop.time()
                with contextlib.suppress(TimeoutError):
                    latest = await asyncio.wait_for(news.get(), _WATCH_S)
    finally:
        service.metrics.streaming(-1)


def _event(service: Service, job: Job, kind: str) -> ServerSentEvent:
    view = job_view(job, service.jobs)
    if kind == "progress":
        assert view.progress is not None
        told = {**view.progress.model_dump(mode="json"), "eta_s": view.eta_s}
        return ServerSentEvent(_json(told), event=kind, id=str(job.revision))
    return ServerSentEvent(view.model_dump_json(), event=kind, id=str(job.revision))


def _look(service: Service, job: Job) -> ServerSentEvent | None:
    try:
        data = service.files.preview(job.id).read_bytes()
    except OSError:  # it has ended in the meantime, and its files are gone
        return None
    image = "data:image/jpeg;base64," + base64.b64encode(data).decode()
    told = {
        "number": job.preview,
        "step": (job.progress or {}).get("step"),
        "window": (job.plan or {}).get("window"),
        "image": image,
    }
    return ServerSentEvent(_json(told), event="preview", id=str(job.revision))


def _json(value: dict[str, Any]) -> str:

    return json.dumps(value, separators=(",", ":"))
