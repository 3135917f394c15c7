"""The application: routes, errors, the page, and what lives as long as it does."""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException

from spotlight_runtime.errors import SpotLightError
from spotlight_service.api import about, inference, jobs, scenes
from spotlight_service.engine.workforce import Workforce
from spotlight_service.problems import (
    MEDIA_TYPE,
    ProblemError,
    disk_is_full,
    fields_in,
    of_error,
    of_validation,
)
from spotlight_service.security.access import scope_of
from spotlight_service.security.gate import Gate
from spotlight_service.serving import Service
from spotlight_service.settings import Settings
from spotlight_service.views import ProblemView

__all__ = ["create_app"]

PAGE: Final = Path(__file__).parent / "page"
ABOUT: Final = (
    "Relight an object in a photograph by its shadow. Send a scene, say where the light is, "
    "fetch the picture. Errors are RFC 9457 problem details."
)
KNOWN: Final = (
    *(ProblemError, HTTPException, RequestValidationError, SpotLightError),
    *(OSError, sqlite3.Error),
)
"""What may go wrong with a request without anything being wrong with the service."""
log = logging.getLogger(__name__)


def create_app(settings: Settings | None = None, workforce: Any = "own") -> FastAPI:
    """Make the application.

    Parameters
    ----------
    settings : Settings, optional
    workforce : {"own"} or None or an object like `Workforce`, optional
        Who works the queue off; by default one worker process a model. None: somebody else.

    Returns
    -------
    FastAPI
        Whose stores are open at once; workers live from startup to shutdown.
    """
    settings = settings or Settings()
    service = Service.open(settings)
    crew = Workforce(settings, service.queue, service.book) if workforce == "own" else workforce

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with service.running(crew):
            yield
        service.close()

    app = FastAPI(
        title="SpotLight",
        description=ABOUT,
        version=inference.package_version(),
        lifespan=lifespan,
        docs_url=None,  # they load scripts from elsewhere; the page explains, /openapi.json tells
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.service = service
    for part in (scenes, jobs, about, inference):
        app.include_router(part.router)
    for kind in KNOWN:
        app.add_exception_handler(kind, _problem)
    app.add_exception_handler(Exception, _problem)
    # Not mounted: that would take paths that are known by another method, whose answer is 405.
    app.router.default = StaticFiles(directory=PAGE, html=True)
    app.add_middleware(
        Gate, settings=settings, access=service.access, counted=service.metrics.answered
    )
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


async def _problem(request: Request, error: Exception) -> Response:
    """Any error as a problem."""
    if isinstance(error, RequestValidationError):
        problem = of_validation(error.errors())
    elif isinstance(error, HTTPException):
        problem = _of_http(error)
    else:
        problem = of_error(error)
    if problem.status == 500 and not isinstance(error, ProblemError):  # that one told already
        log.error("failed", exc_info=error, extra={"request": request.state.request})
    document = {**problem.document(), "request": request.state.request}
    return JSONResponse(document, problem.status, problem.headers, MEDIA_TYPE)


def _of_http(error: HTTPException) -> ProblemError:
    if disk_is_full(error):
        return of_error(OSError(28, "no space"))
    told = fields_in(str(error.detail))
    return ProblemError(error.status_code, str(error.detail), told, error.headers)


def _openapi(app: FastAPI) -> dict[str, Any]:
    """The document: problems and keys are described once, whatever route they are of."""
    if app.openapi_schema:
        return app.openapi_schema
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes
    )
    parts = document.setdefault("components", {})
    problem = ProblemView.model_json_schema(ref_template="#/components/schemas/{model}")
    parts.setdefault("schemas", {}).update(problem.pop("$defs", {}))
    parts["schemas"]["ProblemView"] = problem
    parts["securitySchemes"] = {
        "bearer": {"type": "http", "scheme": "bearer"},
        "key": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
    }
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            if scope_of(method.upper(), path) is not None:
                operation["security"] = [{"bearer": []}, {"key": []}, {}]
    app.openapi_schema = document
    return document
