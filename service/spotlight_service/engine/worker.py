"""``python -m spotlight_service.engine.worker``: claims the jobs of one model and does them.

It is a process, so that neither its arrays nor its end are the API's: the API answers while a
relight runs, and the queue is the store's, which any process can take up where another died.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final

from spotlight_runtime import Relighter
from spotlight_service.engine.children import parent, receive
from spotlight_service.engine.execution import Engine
from spotlight_service.engine.scene_cache import SceneCache
from spotlight_service.logs import configure_logging
from spotlight_service.memory import resident_bytes
from spotlight_service.plans import predicted
from spotlight_service.settings import Settings
from spotlight_service.storage.database import Database
from spotlight_service.storage.files import JobFiles
from spotlight_service.storage.queue import WorkQueue
from spotlight_service.storage.workers import WorkerBook

__all__ = ["Bench", "main", "set_up"]

IDLE_S: Final = 0.01
"""Between two looks into an empty queue, which are a thirtieth of a millisecond each."""
NICENESS: Final = 10
"""Behind the API and the studio, which people wait for; nothing is lost where these are idle."""
BEAT_S: Final = 2.0

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Bench:
    """What a worker works with.

    Attributes
    ----------
    id, model : str
    engine : Engine
    queue : WorkQueue
    book : WorkerBook
    cache : SceneCache
    relighter : Relighter
    plans : dict of str to float
        Seconds that plans take here, once they have been measured.
    """

    id: str
    model: str
    engine: Engine
    queue: WorkQueue
    book: WorkerBook
    cache: SceneCache
    relighter: Relighter
    plans: dict[str, float]

    def predict(self) -> None:
        """Measure what plans take on this machine.

        A model that cannot be run is no reason not to work: its jobs fail, and say why.
        """
        try:
            self.plans.update(predicted(self.relighter))
        except Exception:
            log.exception("not measured", extra={"model": self.model})
        else:
            log.info("measured", extra={"plans": self.plans})

    def work_once(self, stopping: threading.Event) -> bool:
        """Do one job; False if there was none."""
        claim = self.queue.claim(self.id, self.model)
        if claim is None:
            return False
        self.engine.execute(claim, stopping.is_set)
        self.note()
        return True

    def note(self) -> None:
        """Write down that this worker lives, and what it holds."""
        cache = {"hits": self.cache.hits, "misses": self.cache.misses, "bytes": self.cache.bytes}
        facts = {
            "pid": os.getpid(),
            "resident_bytes": resident_bytes(),
            "scene_cache": cache,
            "plans": self.plans,
        }
        self.book.note(self.id, self.model, facts)


def set_up(settings: Settings, model: str, worker: str) -> Bench:
    """Load a model and open the stores.

    Raises
    ------
    ModelError
        If the model is unknown or damaged.
    """
    relighter = Relighter.load(model, engine=settings.engine, threads=settings.threads)
    database = Database(settings.data / "service.db")
    queue = WorkQueue(database, lease=settings.lease_s, attempts=settings.attempts)
    files, cache = JobFiles(settings.data / "jobs"), SceneCache(settings.scene_cache_bytes)
    scenes = settings.data / "scenes"
    engine = Engine(relighter, queue, files, scenes, cache, settings.lease_s)
    book = WorkerBook(database)
    return Bench(worker, model, engine, queue, book, cache, relighter, {})


def main() -> None:
    """Entry point of the process."""
    connection, config = parent()
    configure_logging()
    stopping = threading.Event()
    threading.Thread(target=_obey, args=(connection, stopping), daemon=True).start()
    os.nice(NICENESS)
    settings = Settings.model_validate(config["settings"])
    model, worker = config["model"], config["worker"]
    bench = set_up(settings, model, worker)
    log.info("ready", extra={"model": model, "worker": worker})
    bench.note()
    if settings.measure:
        bench.predict()
    noted = -BEAT_S
    while not stopping.is_set():
        if time.monotonic() - noted > BEAT_S:
            bench.note()
            noted = time.monotonic()
        if not bench.work_once(stopping):
            stopping.wait(IDLE_S)
    bench.book.forget(worker)


def _obey(connection: Connection, stopping: threading.Event) -> None:
    """Stop when the parent says so; end at once when it is gone, or two would do its work."""
    try:
        order: dict[str, Any] = receive(connection)
    except (EOFError, OSError):
        os._exit(1)
    if order.get("stop"):
        stopping.set()
    try:
        receive(connection)
    except (EOFError, OSError):
        os._exit(1)


if __name__ == "__main__":
    main()
