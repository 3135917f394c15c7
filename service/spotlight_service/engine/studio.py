"""The studio: one process for whatever decodes what strangers sent, or is too long for the API.

Its address space is bounded, what takes too long is killed with it, and the next task finds a new
one. ``python -m spotlight_service.engine.studio`` is the process, `StudioDesk` the API's end.
"""

from __future__ import annotations

import json
import logging
import resource
import tempfile
import threading
import time
from typing import Any, Final

from spotlight_service.engine.children import Child, parent, receive, send
from spotlight_service.engine.studio_tasks import TASKS, Studio
from spotlight_service.logs import configure_logging
from spotlight_service.problems import ProblemError, of_error
from spotlight_service.settings import Settings

__all__ = ["StudioDesk", "main"]

RETRY_S: Final = 5
log = logging.getLogger(__name__)


class StudioDesk:
    """Where the API hands in tasks; one at a time, for any thread.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._child: Child | None = None
        self._closed = False

    def ask(self, task: str, **values: Any) -> tuple[dict[str, Any], bytes]:
        """Have a task done; see `Studio` for tasks and their values.

        Raises
        ------
        ProblemError
            What is wrong with the values; 503 where the studio is busy for too long, 413 for a
            task that takes too long or too much.
        """
        if not self._lock.acquire(timeout=self._settings.studio_s):
            raise ProblemError(
                503, "the studio is busy; try again", headers={"Retry-After": str(RETRY_S)}
            )
        try:
            return self._asked(task, values)
        finally:
            self._lock.release()

    def warm(self) -> None:
        """Start the process, so that the first task need not wait for it."""
        with self._lock:
            self._running()

    def close(self) -> None:
        """End the process, whatever it is at."""
        self._closed = True
        child = self._child
        if child is not None:
            child.process.kill()
        with self._lock:
            if self._child is not None:
                self._child.kill()
                self._child = None

    def _running(self) -> Child:
        if self._closed:
            raise ProblemError(503, "the service is shutting down")
        if self._child is None or not self._child.alive:
            settings = self._settings.model_dump(mode="json")
            self._child = Child(__spec__.name, {"settings": settings})
        return self._child

    def _asked(self, task: str, values: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        child = self._running()
        try:
            send(child.connection, {"task": task, "values": values})
            if not child.connection.poll(self._settings.studio_s):
                self._lose(child)
                limit = f"{self._settings.studio_s:g} s"
                raise ProblemError(413, f"{task}: took more than {limit}; send something smaller")
            answer = receive(child.connection)
            data = child.connection.recv_bytes()
        except (EOFError, OSError) as error:
            self._lose(child)
            log.warning("the studio died", extra={"task": task, "cause": repr(error)})
            raise ProblemError(
                413, f"{task}: ended the process that looked at it; send something smaller"
            ) from error
        if "problem" in answer:
            problem = answer["problem"]
            raise ProblemError(problem["status"], problem["detail"], problem["errors"])
        return answer["value"], data

    def _lose(self, child: Child) -> None:
        child.kill()
        self._child = None


def main() -> None:
    """Entry point of the process."""
    connection, config = parent()
    configure_logging()
    settings = Settings.model_validate(config["settings"])
    if settings.studio_bytes:
        resource.setrlimit(resource.RLIMIT_AS, (settings.studio_bytes, settings.studio_bytes))
    studio = Studio(
        settings.scene_cache_bytes,
        settings.max_pixels,
        settings.max_unpacked_bytes,
        settings.max_files,
    )
    while True:
        try:
            order = receive(connection)
        except (EOFError, OSError):
            return
        answer, data = _done(studio, order, str(settings.data))
        send(connection, answer)
        connection.send_bytes(data)


def _done(studio: Studio, order: dict[str, Any], data: str) -> tuple[dict[str, Any], bytes]:
    task, values = order["task"], order["values"]
    assert task in TASKS
    began = time.perf_counter()
    try:
        with tempfile.TemporaryDirectory(prefix="studio-") as scratch:
            extra = {"scratch": scratch} if task in ("convert", "sketch") else {}
            value, picture = getattr(studio, task)(**values, **extra)
        answer: tuple[dict[str, Any], bytes] = {"value": value}, picture
    except Exception as error:  # the task's failure is the task's; the studio goes on
        problem = of_error(error, _paths(values, data))
        if problem.status == 500:
            log.exception("failed", extra={"task": task})
        answer = {"problem": json.loads(json.dumps(problem.document()))}, b""
    log.info("task", extra={"task": task, "seconds": round(time.perf_counter() - began, 4)})
    return answer


def _paths(values: dict[str, Any], data: str) -> list[str]:
    """Paths that messages may hold and nobody should see, the longest first."""
    found = [v for k, v in values.items() if isinstance(v, str) and v.startswith("/")]
    drafts = [f"{path}/{inner}" for path in found for inner in ("unpacked", "scene")]
    return sorted({*found, *drafts, data, tempfile.gettempdir()}, key=len, reverse=True)


if __name__ == "__main__":
    main()
