"""The Open Inference Protocol's view of the service: health, and models as servers list them."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

from fastapi import APIRouter, Path, Response

from spotlight_service.api.common import Here, problems
from spotlight_service.problems import FieldError, ProblemError
from spotlight_service.serving import Service

__all__ = ["package_version", "router"]

router = APIRouter(prefix="/v2", tags=["inference"])
Model = Annotated[str, Path(min_length=1, max_length=200)]


@router.get("", responses=problems())
async def server() -> dict[str, Any]:
    """Name and version."""
    return {"name": "spotlight-serve", "version": package_version(), "extensions": []}


@router.get("/health/live", responses=problems())
async def live() -> dict[str, bool]:
    """Whether the process answers."""
    return {"live": True}


@router.get("/health/ready", responses=problems())
async def ready(service: Here, response: Response) -> dict[str, bool]:
    """Whether every model has a worker."""
    living = service.book.living()
    missing = [model for model in service.settings.models if model not in living]
    if missing or service.broker.closing:
        what = "the service is shutting down" if service.broker.closing else f"no worker: {missing}"
        raise ProblemError(
            503, f"ready: expected a worker for every model, {what}", headers={"Retry-After": "2"}
        )
    return {"ready": True}


@router.get("/models", responses=problems())
async def list_models(service: Here) -> dict[str, list[str]]:
    """Names of the models, as servers of the protocol list them."""
    return {"models": list(service.settings.models)}


@router.get("/models/{model}", responses=problems())
async def model_metadata(model: Model, service: Here) -> dict[str, Any]:
    """What a model takes and gives: the request of POST /v1/relight, and a picture."""
    _check(service, model)
    return {
        "name": model,
        "versions": [package_version()],
        "platform": "onnxruntime_onnx",
        "inputs": [{"name": "request", "datatype": "BYTES", "shape": [1]}],
        "outputs": [{"name": "image", "datatype": "UINT8", "shape": [-1, -1, 3]}],
    }


@router.get("/models/{model}/ready", responses=problems())
async def model_ready(model: Model, service: Here) -> dict[str, Any]:
    """Whether a model has a worker."""
    _check(service, model)
    if model not in service.book.living():
        raise ProblemError(
            503, f"{model}: no worker has it loaded yet", headers={"Retry-After": "2"}
        )
    return {"name": model, "ready": True}


def package_version() -> str:
    """Of this distribution."""
    try:
        return version("spotlight-relight")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "0"


def _check(service: Service, model: str) -> None:
    if model not in service.settings.models:
        known = ", ".join(service.settings.models)
        raise FieldError("model", f"one of {known}", model, status=404)
