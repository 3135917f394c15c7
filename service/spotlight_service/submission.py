"""From a request to a job: checked in every way that takes no relight, then put into the queue."""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import json
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from spotlight_runtime.errors import SpotLightError
from spotlight_service import plans
from spotlight_service.engine.uploads import check_picture
from spotlight_service.lighting import light_of
from spotlight_service.problems import FieldError, ProblemError, of_error
from spotlight_service.schemas import PLANNED, DrawnLight, PlacedLight, RelightRequest
from spotlight_service.security.keys import Caller
from spotlight_service.serving import Service
from spotlight_service.storage.files import require_space
from spotlight_service.storage.records import Submission
from spotlight_service.storage.scene_info import SceneInfo

__all__ = ["check_lights", "drawings_of", "owned_scene", "request_digest", "submit"]

Drawing = tuple[int, str, bytes]
"""Number of the light, ``shadow`` or ``negative``, and the picture's bytes."""
LONGEST_KEY: Final = 200


async def submit(
    service: Service, caller: Caller, request: RelightRequest, key: str | None = None
) -> Submission:
    """Make a job of a request.

    Parameters
    ----------
    service : Service
    caller : Caller
    request : RelightRequest
    key : str, optional
        Makes the same submission only once.

    Raises
    ------
    ProblemError
        404 for a scene that is not the caller's, 422 for what is wrong with the request, 429 for a
        full queue, 507 for a full disk.
    """
    if key is not None and not 0 < len(key) <= LONGEST_KEY:
        raise FieldError("Idempotency-Key", f"1 to {LONGEST_KEY} characters", len(key))
    deadline = _checked(service, request)
    owned_scene(service, caller, request.scene)
    check_lights(request.lights)
    drawings = list(drawings_of(request.lights, service.settings.max_pixels))
    digest, body = request_digest(request, drawings)
    known = None if key is None else service.jobs.keyed(caller.id, key)
    if known is not None and known.digest == digest:
        return Submission(known, created=False)
    job = uuid.uuid4().hex

    def queued() -> Submission:
        settings = service.settings
        require_space(settings.data, settings.min_free_bytes)
        try:
            for number, kind, data in drawings:
                service.files.write(service.files.drawing(job, number, kind), data)
            if drawings:
                folder = str(service.scenes.folder(request.scene))
                drawn, lights = str(service.files.folder(job)), body["lights"]
                service.sketches.ask(
                    "check_drawings",
                    scene=request.scene,
                    folder=folder,
                    lights=lights,
                    drawings=drawn,
                )
            service.scenes.use(request.scene, caller.id)
            made = service.jobs.submit(job, caller.id, request.model, body, digest, deadline, key)
        except BaseException:
            service.files.forget(job)
            raise
        if not made.created:
            service.files.forget(job)
        return made

    return await asyncio.to_thread(queued)


def owned_scene(service: Service, caller: Caller, scene: str) -> SceneInfo:
    """A caller's scene.

    Raises
    ------
    ProblemError
        404 where there is none, or it is another's: who may not see it learns nothing.
    """
    info = service.scenes.find(scene, caller.id)
    if info is None:
        raise FieldError(
            "scene", "the id of a scene of yours", scene, status=404, advice="POST /v1/scenes first"
        )
    return info


def check_lights(lights: Sequence[PlacedLight | DrawnLight]) -> None:
    """Raise what the runtime would of placed lights.

    Raises
    ------
    ProblemError
    """
    for number, light in enumerate(lights):
        if isinstance(light, PlacedLight):
            with _naming(f"lights[{number}]"):
                light_of(light.model_dump())


def drawings_of(lights: Sequence[PlacedLight | DrawnLight], most_pixels: int) -> Iterator[Drawing]:
    """Pictures of drawn shadows, looked at and not yet decoded.

    Raises
    ------
    FieldError
    """
    for number, light in enumerate(lights):
        if not isinstance(light, DrawnLight):
            continue
        for kind, text in (("shadow", light.shadow), ("negative", light.negative)):
            if text is None:
                continue
            field = f"lights[{number}].{kind}"
            head, comma, rest = text.partition(",")
            try:
                data = base64.b64decode(
                    rest if comma and head.startswith("data:") else text, validate=True
                )
            except (binascii.Error, ValueError) as error:
                raise FieldError(field, "a picture in base64", f"other text ({error})") from error
            if check_picture(field, data, most_pixels) in (".exr", ".hdr"):
                raise FieldError(field, "a PNG, JPEG or WebP picture", "another format", status=415)
            yield number, kind, data


def request_digest(
    request: RelightRequest, drawings: Sequence[Drawing]
) -> tuple[str, dict[str, Any]]:
    """SHA-256 of a request, and the request as jobs have it: drawings by their SHA-256.

    A client that serialises what it sent in the same way (keys sorted, no spaces, defaults filled
    in) gets the same digest and can tell that a result is its own.
    """
    body = request.model_dump(mode="json")
    for number, kind, data in drawings:
        body["lights"][number][kind] = hashlib.sha256(data).hexdigest()
    body["options"] = request.options()
    for name in ("gamma", "beta", "seed", *PLANNED):
        del body[name]
    text = json.dumps(body, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest(), body


def _checked(service: Service, request: RelightRequest) -> float:
    """Check what is not light; returns the deadline in seconds."""
    settings = service.settings
    if request.model not in settings.models:
        raise FieldError("model", f"one of {', '.join(settings.models)}", request.model)
    deadline = request.deadline_s or settings.deadline_s
    if deadline > settings.longest_deadline_s:
        raise FieldError("deadline_s", f"at most {settings.longest_deadline_s:g}", deadline)
    drawn = any(isinstance(light, DrawnLight) for light in request.lights)
    if drawn and request.negative is not None:
        raise FieldError("negative", "nothing beside a drawn light, which has its own", "one")
    if len(request.lights) > 1 and isinstance(request.negative, PlacedLight):
        raise FieldError("negative", "opposite or none for several lights", "a light")
    if isinstance(request.negative, PlacedLight):
        with _naming("negative"):
            light_of(request.negative.model_dump())
    if request.plan is not None and request.budget_s is not None:
        raise FieldError("budget_s", "a plan or a budget", "both", advice="leave one out")
    wishes = {"options": request.options(), "plan": request.plan, "budget_s": request.budget_s}
    with _naming(""):
        plans.check_plan(wishes)
    return deadline


@contextmanager
def _naming(where: str) -> Iterator[None]:
    """Say where in the request it was, if the runtime complains."""
    try:
        yield
    except SpotLightError as error:
        problem = of_error(error)
        for each in problem.errors:
            each["field"] = ".".join(part for part in (where, each["field"]) if part)
        detail = f"{where}: {problem.detail}" if where else problem.detail
        raise ProblemError(problem.status, detail, problem.errors) from error
