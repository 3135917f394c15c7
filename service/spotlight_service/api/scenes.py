"""Scenes: sent as bundle, as photograph and object, or by the name of one that comes along."""

from __future__ import annotations

import asyncio
import base64
import shutil
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, File, Form, Query, Request, Response, UploadFile
from starlette.datastructures import FormData

from spotlight_service.api.common import (
    FORMS,
    JSON,
    CallerHere,
    Here,
    SceneId,
    asked,
    problems,
    takes,
)
from spotlight_service.problems import FieldError
from spotlight_service.schemas import ShadowRequest
from spotlight_service.security.keys import Caller
from spotlight_service.serving import Service
from spotlight_service.storage.files import require_space
from spotlight_service.storage.scene_info import SceneInfo
from spotlight_service.submission import check_lights, drawings_of, owned_scene
from spotlight_service.views import SceneView, scene_view
from spotlight_spec import decode

__all__ = ["router"]

router = APIRouter(prefix="/v1/scenes", tags=["scenes"])
PNG: Final[dict[int | str, dict[str, Any]]] = {
    200: {"content": {"image/png": {}}, "description": "The picture."}
}
Upload = Annotated[UploadFile | None, File()]
Number = Annotated[float | None, Form(allow_inf_nan=False)]


@router.post(
    "",
    status_code=201,
    response_model=SceneView,
    dependencies=[takes(*FORMS)],
    responses={**problems(415, 507), 200: {"model": SceneView, "description": "Known already."}},
    summary="Send a scene, or make one of a photograph and an object",
    openapi_extra={
        "requestBody": {
            "content": {
                "multipart/form-data": {
                    "examples": {
                        "sample": {"summary": "One that comes along", "value": {"sample": "goblet"}}
                    }
                }
            }
        }
    },
)
async def make_scene(
    request: Request,
    response: Response,
    service: Here,
    caller: CallerHere,
    bundle: Annotated[UploadFile | None, File(description="Zip of a scene bundle.")] = None,
    photo: Annotated[UploadFile | None, File(description="Photograph, PNG to EXR.")] = None,
    object: Annotated[
        UploadFile | None,
        File(description="3-D model (.glb, self-contained .gltf, .obj), or a cut-out picture."),
    ] = None,
    mask: Annotated[
        UploadFile | None, File(description="Of a cut-out without transparency: white on it.")
    ] = None,
    sample: Annotated[
        str | None, Form(max_length=100, description="Name of a scene that comes along.")
    ] = None,
    at: Annotated[
        str,
        Form(
            max_length=100,
            description="Where the object stands: fractions of the picture, from the upper left.",
        ),
    ] = "0.5,0.8",
    yaw: Annotated[float, Form(ge=-3600, le=3600, description="Degrees, seen from above.")] = 0.0,
    size: Annotated[float | None, Form(gt=0, le=1000, description="Longest side, metres.")] = None,
    height: Annotated[float | None, Form(gt=0, le=1000, description="Or height, metres.")] = None,
    variant: Annotated[str | None, Form(max_length=200, description="Of a glTF.")] = None,
    fov: Annotated[
        float | None, Form(gt=0, lt=180, description="Horizontal field of view, degrees.")
    ] = None,
    horizon: Annotated[
        float | None, Form(ge=-10, le=10, description="Row of the horizon, fraction of the height.")
    ] = None,
    camera_height: Annotated[float | None, Form(gt=0, le=1000, description="Metres.")] = None,
    occlusion: Annotated[bool, Form(description="Nearer things hide the object.")] = False,
) -> SceneView:
    """Store a scene; the same content always has the same id.

    Send one of: ``bundle``; ``photo`` and ``object`` (and ``mask``) with where it stands;
    ``sample``. Files are judged by their content, names and declared types count for nothing.
    """
    parts = {"photo": photo, "object": object, "mask": mask}
    sent = {name: file for name, file in parts.items() if file is not None}
    fields = {
        "at": _point(at),
        "yaw": yaw,
        "size": size,
        "height": height,
        "variant": variant,
        "fov": fov,
        "horizon": horizon,
        "camera_height": camera_height,
        "occlusion": occlusion,
    }
    known = {"bundle", "sample", *parts, *fields}
    _check_names(await request.form(), known, () if sent else fields)
    ways = [w for w, given in (("bundle", bundle), ("photo", sent), ("sample", sample)) if given]
    if len(ways) != 1 or (sent and not {"photo", "object"} <= set(sent)):
        got = " and ".join(
            [*(["bundle"] if bundle else []), *sent, *(["sample"] if sample else [])]
        )
        raise FieldError("bundle", "a bundle, a photo and an object, or a sample", got or "nothing")
    require_space(service.settings.data, service.settings.min_free_bytes)
    info, fresh = await asyncio.to_thread(_stored, service, caller, bundle, sent, sample, fields)
    response.status_code = 201 if fresh else 200
    response.headers["Location"] = f"/v1/scenes/{info.id}"
    return scene_view(info)


@router.get("/{scene}", response_model=SceneView, responses=problems())
async def get_scene(scene: SceneId, service: Here, caller: CallerHere) -> SceneView:
    """What is known of a scene of yours."""
    return scene_view(owned_scene(service, caller, scene))


@router.get("/{scene}/picture", response_class=Response, responses={**problems(), **PNG})
async def get_picture(
    scene: SceneId,
    service: Here,
    caller: CallerHere,
    show: Annotated[
        Literal["draft", "background", "mask"],
        Query(description="The object put in plainly, the photograph alone, or where it is."),
    ] = "draft",
) -> Response:
    """A scene of yours as a picture, without anybody's light."""
    owned_scene(service, caller, scene)
    folder = str(service.scenes.folder(scene))
    _, data = await asked(service.sketches, "picture", scene=scene, folder=folder, show=show)
    return Response(data, media_type="image/png")


@router.post(
    "/{scene}/shadow",
    response_class=Response,
    dependencies=[takes(JSON)],
    responses={**problems(415, 507), **PNG},
    summary="Sketch a light in a blink",
)
async def sketch_shadow(
    scene: SceneId, request: ShadowRequest, service: Here, caller: CallerHere
) -> Response:
    """Where lights' shadows fall: no diffusion, fast enough to drag a light.

    The header ``Spotlight-Notice`` says why a shadow is hardly seen, where it is.
    """
    owned_scene(service, caller, scene)
    check_lights(request.lights)
    drawings = list(drawings_of(request.lights, service.settings.max_pixels))
    lights = [light.model_dump(mode="json") for light in request.lights]
    for number, kind, data in drawings:
        lights[number][kind] = base64.b64encode(data).decode()
    answer, data = await asked(
        service.sketches,
        "sketch",
        scene=scene,
        folder=str(service.scenes.folder(scene)),
        lights=lights,
        show=request.show,
        side=request.side,
    )
    headers = {}
    if answer["notices"]:
        told = " ".join(answer["notices"]).encode("ascii", "replace").decode()
        headers["Spotlight-Notice"] = " ".join(told.split())
    return Response(data, media_type="image/png", headers=headers)


def _check_names(form: FormData, known: Collection[str], idle: Collection[str]) -> None:
    """Raise where a form has fields that would count for nothing."""
    for name, value in form.items():
        got = value if isinstance(value, str) else "a file"
        if name not in known:
            raise FieldError(name, "no field of this name", got)
        if name in idle:
            raise FieldError(name, "nothing where no object is put into a photo", got)


def _stored(
    service: Service,
    caller: Caller,
    bundle: UploadFile | None,
    parts: dict[str, UploadFile],
    sample: str | None,
    fields: dict[str, Any],
) -> tuple[SceneInfo, bool]:
    """Have the studio make the scene in a draft folder, then take it in."""
    with service.scenes.draft() as draft:
        values: dict[str, Any] = {"draft_folder": str(draft)}
        if bundle is not None:
            values["upload"] = str(_saved(bundle, draft / "upload"))
            task = "bundle"
        elif sample is not None:
            values["name"] = sample
            task = "sample"
        else:
            values["parts"] = {n: str(_saved(file, draft / n)) for n, file in parts.items()}
            values["fields"] = fields
            task = "compose"
        answer, _ = service.uploads.ask(task, **values)
        info = decode(SceneInfo, answer["info"], "scene")
        fresh = service.scenes.find(info.id, caller.id) is None
        service.scenes.adopt(Path(answer["folder"]), info, caller.id)
    return info, fresh


def _saved(upload: UploadFile, path: Path) -> Path:
    with path.open("wb") as file:
        shutil.copyfileobj(upload.file, file)
    return path


def _point(text: str) -> list[float]:
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        raise FieldError("at", "two numbers with a comma between", text) from None
    if not (0.0 <= first <= 1.0 and 0.0 <= second <= 1.0):
        raise FieldError("at", "fractions of the picture from 0 to 1", text)
    return [first, second]
