"""News of jobs, from the store to whoever waits for them in this process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Final

from spotlight_service.storage.jobs import JobStore
from spotlight_service.storage.records import Job

__all__ = ["Broker"]

LOOK_S: Final = 0.015
"""Between two looks at the store: a query of a tenth of a millisecond, a percent of a short job."""
BACKLOG: Final = 64
"""News a slow reader may fall behind by; it is then told the latest only."""


class Broker:
    """Looks for changes and passes them on; for one event loop.

    Workers are other processes, which may be replicas on a cluster: the store is all they share.

    Parameters
    ----------
    store : JobStore
    listener : callable
        Told every change.
    """

    def __init__(self, store: JobStore, listener: Callable[[Job], None]) -> None:
        self._store, self._listener = store, listener
        self._readers: dict[str, set[asyncio.Queue[Job | None]]] = {}
        self._revision = store.revision()
        self._loop: asyncio.AbstractEventLoop | None = None
        self.closing = False

    async def run(self) -> None:
        """Look until cancelled."""
        self._loop = asyncio.get_running_loop()
        while True:
            self.look()
            await asyncio.sleep(LOOK_S)

    def look(self) -> None:
        """Pass on what has changed."""
        for job in self._store.changes(self._revision):
            self._revision = max(self._revision, job.revision)
            self._listener(job)
            for reader in self._readers.get(job.id, ()):
                if reader.full():
                    reader.get_nowait()
                reader.put_nowait(job)

    def close(self) -> None:
        """Tell everybody who waits that there is nothing more to come."""
        self.closing = True
        for readers in self._readers.values():
            for reader in readers:
                if reader.full():
                    reader.get_nowait()
                reader.put_nowait(None)

    def close_soon(self) -> None:
        """`close`, from a signal handler or another thread."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self.close)

    @asynccontextmanager
    async def news(self, job: str) -> AsyncIterator[asyncio.Queue[Job | None]]:
        """A queue of a job's changes from now on; None: the service stops."""
        reader: asyncio.Queue[Job | None] = asyncio.Queue(BACKLOG)
        self._readers.setdefault(job, set()).add(reader)
        if self.closing:
            reader.put_nowait(None)
        try:
            yield reader
        finally:
            self._readers[job].discard(reader)
            if not self._readers[job]:
                del self._readers[job]

    async def final(self, job: Job, seconds: float) -> Job:
        """A job once nothing will change any more, or as it is when the time is over."""
        async with self.news(job.id) as reader:
            latest = self._store.get(job.id, job.owner) or job
            try:
                async with asyncio.timeout(seconds):
                    while not latest.final:
                        news = await reader.get()
                        if news is None:
                            break
                        latest = news
            except TimeoutError:
                pass
            return latest
