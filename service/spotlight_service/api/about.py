"""What the service can do, how it is, and its numbers."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from spotlight_runtime.networks.models import ModelFolder, resolve_model
from spotlight_service import plans
from spotlight_service.api.common import Here, problems
from spotlight_service.api.jobs import FORMATS
from spotlight_service.engine.studio_tasks import samples
from spotlight_service.schemas import MOST_LIGHTS
from spotlight_service.serving import Service

__all__ = ["model_facts", "router"]

router = APIRouter(tags=["about"])


@router.get("/v1/models", responses=problems())
async def list_models(service: Here) -> dict[str, list[dict[str, Any]]]:
    """The models this service relights with."""
    return {"models": [model_facts(service, name) for name in service.settings.models]}


@router.get("/v1/capabilities", responses=problems())
async def capabilities(service: Here) -> dict[str, Any]:
    """Limits, plans with this machine's times, samples, formats, and the queue as it is."""
    settings = service.settings
    waiting = sum(n for (_, state), n in service.jobs.counts().items() if state == "queued")
    return {
        "plans": {model: _plans(service, model) for model in settings.models},
        "limits": {
            "upload_bytes": settings.max_upload_bytes,
            "json_bytes": settings.max_json_bytes,
            "unpacked_bytes": settings.max_unpacked_bytes,
            "files": settings.max_files,
            "pixels": settings.max_pixels,
            "lights": MOST_LIGHTS,
            "queue": settings.queue,
            "deadline_s": settings.longest_deadline_s,
            "wait_s": settings.longest_wait_s,
            "result_ttl_s": settings.result_ttl_s,
            "requests_per_minute": settings.requests_per_minute,
        },
        "queue": {
            "waiting": waiting,
            "wait_s": round(service.jobs.seconds(settings.models[0]) * waiting, 2),
        },
        "samples": samples(),
        "formats": list(FORMATS),
        "keys_needed": service.access.needs_keys(),
    }


@router.get("/metrics", response_class=Response, responses=problems())
def metrics(service: Here) -> Response:
    """Numbers for Prometheus."""
    return Response(generate_latest(service.metrics.registry), media_type=CONTENT_TYPE_LATEST)


def _plans(service: Service, model: str) -> list[dict[str, Any]]:
    measured = [facts["plans"] for facts in service.book.living().get(model, ())]
    graphs = {graph.name for graph in resolve_model(model).manifest.graphs}
    return plans.offered(next(filter(None, measured), {}), "denoiser_shallow" in graphs)


def model_facts(service: Service, name: str) -> dict[str, Any]:
    """Facts about a model, and how many workers have it loaded."""
    folder: ModelFolder = resolve_model(name)
    workers = len(service.book.living().get(name, ()))
    spec = folder.manifest.backbone
    facts = folder.summary()
    return {
        **facts,
        "name": name,
        "title": spec.title,
        "size": spec.size,
        "steps": spec.schedule.steps,
        "workers": workers,
        "ready": workers > 0,
        "seconds": round(service.jobs.seconds(name), 3),
    }
