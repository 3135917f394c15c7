"""The parts of a running service, put together once and handed to whoever answers requests."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TextIO

from spotlight_service.broker import Broker
from spotlight_service.engine.studio import StudioDesk
from spotlight_service.engine.workforce import Workforce
from spotlight_service.metrics import Metrics
from spotlight_service.security.access import Access
from spotlight_service.security.keys import KeyStore
from spotlight_service.security.rates import RateLimiter
from spotlight_service.settings import Settings
from spotlight_service.storage.database import Database
from spotlight_service.storage.files import JobFiles
from spotlight_service.storage.jobs import JobStore
from spotlight_service.storage.queue import WorkQueue
from spotlight_service.storage.scenes import SceneStore
from spotlight_service.storage.workers import WorkerBook

__all__ = ["Service"]

TIDY_S: Final = 20.0
"""Between two rounds of tidying up."""
STRAY_S: Final = 3600.0
"""Seconds after which files of no job are removed."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Service:
    """A service.

    Attributes
    ----------
    settings : Settings
    lock : file
        Held as long as it is open: one service a data folder.
    database, jobs, queue, files, scenes, book
        Stores.
    keys, access
        Security.
    uploads, sketches : StudioDesk
        Two studios: strangers' files never hold up a light that is being dragged.
    broker : Broker
    metrics : Metrics
    """

    settings: Settings
    lock: TextIO
    database: Database
    jobs: JobStore
    queue: WorkQueue
    files: JobFiles
    scenes: SceneStore
    book: WorkerBook
    access: Access
    uploads: StudioDesk
    sketches: StudioDesk
    broker: Broker
    metrics: Metrics

    @classmethod
    def open(cls, settings: Settings) -> Service:
        """Open the stores of a data folder; nothing runs yet.

        Raises
        ------
        RuntimeError
            If another service uses the data folder.
        """
        settings.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = only_one(settings.data / "service.lock")
        database = Database(settings.data / "service.db")
        jobs = JobStore(database, limit=settings.queue)
        book = WorkerBook(database)
        metrics = Metrics(jobs, book)
        return cls(
            settings,
            lock,
            database,
            jobs,
            WorkQueue(database, lease=settings.lease_s, attempts=settings.attempts),
            JobFiles(settings.data / "jobs"),
            SceneStore(settings.data / "scenes", database),
            book,
            Access(KeyStore(database), RateLimiter(settings.requests_per_minute)),
            StudioDesk(settings),
            StudioDesk(settings),
            Broker(jobs, metrics.changed),
            metrics,
        )

    @asynccontextmanager
    async def running(self, workforce: Workforce | None) -> AsyncIterator[None]:
        """Work until the block ends: workers, news, tidying up.

        Parameters
        ----------
        workforce : Workforce, optional
            None where somebody else works the queue off.
        """
        back = self.queue.abandon()
        self.book.forget()
        log.info("started", extra={"jobs_taken_back": back, "data": str(self.settings.data)})
        tasks = [asyncio.create_task(self.broker.run()), asyncio.create_task(self._tidy())]
        if workforce is not None:
            tasks.append(asyncio.create_task(workforce.run()))
        await asyncio.to_thread(self.sketches.warm)
        try:
            yield
        finally:
            self.broker.close()
            for task in tasks:
                task.cancel()
            for task in tasks:
                with suppress(asyncio.CancelledError):
                    await task
            if workforce is not None:
                await asyncio.to_thread(workforce.stop, self.settings.stop_s)
            self.uploads.close()
            self.sketches.close()
            log.info("stopped")

    def close(self) -> None:
        """Close the stores, and leave the data folder to others."""
        self.database.close()
        self.lock.close()

    async def _tidy(self) -> None:
        while True:
            try:
                await asyncio.to_thread(self.tidy)
            except Exception:  # a full disk, say; the next round may find it otherwise
                log.exception("tidying up failed")
            await asyncio.sleep(TIDY_S)

    def tidy(self) -> None:
        """Forget what is old, and jobs nobody works on any more."""
        self.queue.sweep()
        for job in self.jobs.expire(self.settings.result_ttl_s):
            self.files.forget(job)
        for job in self.files.strays(self.jobs.ids(), STRAY_S, time.time()):
            self.files.forget(job)
        self.scenes.evict(self.settings.scene_store_bytes, self.jobs.scenes_in_use())


def only_one(path: Path) -> TextIO:
    """Hold a file against any other process until it is closed.

    Raises
    ------
    RuntimeError
        If another process holds it.
    """
    file = path.open("a")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise RuntimeError(
            f"{path.parent}: another service uses this data folder; stop it, or give this one "
            "a folder of its own (--data)"
        ) from error
    return file
