"""What routes share: the service, the caller, and documented problems."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any, Final

from fastapi import Depends, Path, Request

from spotlight_service.engine.studio import StudioDesk
from spotlight_service.problems import MEDIA_TYPE, FieldError
from spotlight_service.schemas import SCENE_ID
from spotlight_service.security.keys import Caller
from spotlight_service.serving import Service
from spotlight_service.storage.records import Job
from spotlight_service.views import ProblemView

__all__ = [
    "FORMS",
    "JSON",
    "CallerHere",
    "Here",
    "JobId",
    "SceneId",
    "asked",
    "own_job",
    "problems",
    "takes",
]

JOB_ID: Final = r"^[0-9a-f]{32}$"
JSON: Final = "application/json"
FORMS: Final = ("multipart/form-data", "application/x-www-form-urlencoded")

_WHY: Final = {
    400: "The body is not what its type says.",
    401: "A key is needed, or the one given is not valid.",
    403: "The key lacks the scope, or the page is another's.",
    404: "There is none, or it is another's.",
    405: "Not with this method.",
    406: "None of the formats that are accepted can be had.",
    408: "The body took too long to arrive.",
    409: "Not in this state.",
    413: "Too large, too many pixels, or it takes too long to look at.",
    415: "Not one of the formats that are let in.",
    421: "Without keys, the service answers to this machine's own names only.",
    422: "Understood, and not possible; names field, expected, got.",
    429: "Too many requests, or the queue is full; see Retry-After.",
    500: "The service's own fault; the log has it under the request's id.",
    503: "Shutting down, starting, or too busy; see Retry-After.",
    504: "The job was not done by its deadline.",
    507: "The disk is full.",
}
_EVERYWHERE: Final = (400, 401, 403, 404, 408, 413, 421, 422, 429, 500, 503)


def problems(*more: int) -> dict[int | str, dict[str, Any]]:
    """Documentation of the errors that a route may answer with: those of all, and these."""
    schema = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemView"}}}
    return {
        status: {"description": _WHY[status], "content": schema}
        for status in sorted({*_EVERYWHERE, *more})
    }


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


def _caller(request: Request) -> Caller:
    caller: Caller = request.state.caller
    return caller


Here = Annotated[Service, Depends(_service)]
CallerHere = Annotated[Caller, Depends(_caller)]
JobId = Annotated[str, Path(pattern=JOB_ID, description="As the job's answer says.")]
SceneId = Annotated[str, Path(pattern=SCENE_ID, description="As the scene's answer says.")]


def takes(*kinds: str) -> Any:
    """A dependency: a body of one of these types, or 415 before anybody looks into it."""

    async def checked(request: Request) -> None:
        given = request.headers.get("content-type", "")
        if given.partition(";")[0].strip().lower() not in kinds:
            raise FieldError("Content-Type", " or ".join(kinds), given or "nothing", status=415)

    return Depends(checked)


def own_job(service: Service, caller: Caller, job: str) -> Job:
    """A caller's job.

    Raises
    ------
    FieldError
        404 where there is none, or it is another's, or it was kept long enough.
    """
    found = service.jobs.get(job, caller.id)
    if found is None:
        raise FieldError("job", "the id of a job of yours", job, status=404)
    return found


async def asked(desk: StudioDesk, task: str, **values: Any) -> tuple[dict[str, Any], bytes]:
    """Have the studio do something without holding anybody up; see `StudioDesk.ask`."""
    return await asyncio.to_thread(lambda: desk.ask(task, **values))


__all__ += ["ProblemView"]
