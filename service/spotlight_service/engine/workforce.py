"""Keeping workers alive: one a model, begun again when it dies, its job given back to the queue."""

from __future__ import annotations

import asyncio
import logging
import uuid
from dataclasses import dataclass
from typing import Final

from spotlight_service.engine.children import Child
from spotlight_service.settings import Settings
from spotlight_service.storage.queue import WorkQueue
from spotlight_service.storage.workers import WorkerBook

__all__ = ["Workforce"]

LOOK_S: Final = 0.25
"""Between two looks at the workers."""
FIRST_PAUSE_S: Final = 0.5
LONGEST_PAUSE_S: Final = 30.0
"""Before a worker that dies again and again is begun once more; doubles from the first pause."""
MODULE: Final = "spotlight_service.engine.worker"

log = logging.getLogger(__name__)


@dataclass
class _Post:
    """A worker's place, whoever fills it."""

    model: str
    worker: str = ""
    child: Child | None = None
    pause: float = FIRST_PAUSE_S


class Workforce:
    """The workers of a service.

    Parameters
    ----------
    settings : Settings
    queue : WorkQueue
    book : WorkerBook
    """

    def __init__(self, settings: Settings, queue: WorkQueue, book: WorkerBook) -> None:
        self._settings, self._queue, self._book = settings, queue, book
        self._posts = [_Post(model) for model in settings.models]

    async def run(self) -> None:
        """Begin the workers, and begin them again until cancelled."""
        await asyncio.gather(*(self._keep(post) for post in self._posts))

    def stop(self, patience: float) -> None:
        """Let each finish its step and give its job back."""
        for post in self._posts:
            if post.child is not None:
                post.child.stop(patience)
                self._clear(post)

    async def _keep(self, post: _Post) -> None:
        while True:
            post.worker = f"{post.model}-{uuid.uuid4().hex[:12]}"
            settings = self._settings.model_dump(mode="json")
            config = {"settings": settings, "model": post.model, "worker": post.worker}
            post.child = Child(MODULE, config)
            began = asyncio.get_running_loop().time()
            while post.child.alive:
                await asyncio.sleep(LOOK_S)
            status = post.child.process.returncode
            log.error("worker died", extra={"worker": post.worker, "status": status})
            post.child.connection.close()
            await asyncio.to_thread(self._clear, post)
            lived = asyncio.get_running_loop().time() - began
            post.pause = min(post.pause * 2, LONGEST_PAUSE_S) if lived < 60 else FIRST_PAUSE_S
            await asyncio.sleep(post.pause)

    def _clear(self, post: _Post) -> None:
        self._queue.abandon(post.worker)
        self._book.forget(post.worker)
        post.child = None
