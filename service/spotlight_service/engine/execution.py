"""One claimed job from its beginning to its end; the same in a worker and in a Ray replica."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from spotlight_runtime import Progress, Relighter, RelightResult, write_image
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.images import encode_png
from spotlight_runtime.relighting.sweep import Tile, contact_sheet, make_tile
from spotlight_service import plans
from spotlight_service.engine.scene_cache import SceneCache
from spotlight_service.lighting import caption, guides_of, negative_of
from spotlight_service.problems import ProblemError, of_error
from spotlight_service.storage.files import JobFiles
from spotlight_service.storage.queue import WorkQueue
from spotlight_service.storage.records import Claim, Job
from spotlight_spec import replacing

__all__ = ["Engine", "Stopping"]

PREVIEW_SHARE: Final = 0.1
"""Of a job's time that may go into showing it to whoever watches."""
PREVIEW_QUALITY: Final = 85
BEATS: Final = 3
"""Signs of life within one lease."""

log = logging.getLogger(__name__)
Stopping = Callable[[], bool]
"""Whether the process is asked to stop: the job goes back to the queue at the end of its step."""


class _LeftError(Exception):
    """A job that is not to be gone on with; says why."""

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.why = why


class Engine:
    """A relighter with what it needs to work off jobs.

    Parameters
    ----------
    relighter : Relighter
    queue : WorkQueue
    files : JobFiles
    scenes : Path
        Where scenes lie, one folder an id.
    cache : SceneCache
    lease : float
        As the queue's.
    """

    def __init__(
        self,
        relighter: Relighter,
        queue: WorkQueue,
        files: JobFiles,
        scenes: Path,
        cache: SceneCache,
        lease: float,
    ) -> None:
        self._relighter, self._queue, self._files = relighter, queue, files
        self._scenes, self._cache, self._lease = scenes, cache, lease

    def execute(self, claim: Claim, stopping: Stopping) -> None:
        """Do a job; whatever becomes of it is in the store afterwards."""
        said: dict[str, Any] = {"job": claim.job.id, "attempt": claim.job.attempt}
        log.info("begun", extra=said)
        started = time.perf_counter()
        try:
            with self._alive(claim):
                report = self._relit(claim, stopping)
            outcome = "done" if self._queue.finish(claim, "done", report=report) else "lost"
        except _LeftError as left:
            outcome = left.why
            self._leave(claim, left.why)
        except Exception as error:  # a job's failure is the job's; the worker goes on
            outcome = "failed"
            self._fail(claim, error)
        seconds = round(time.perf_counter() - started, 4)
        log.info(outcome, extra={**said, "seconds": seconds})

    def _fail(self, claim: Claim, error: Exception) -> None:
        job = claim.job
        hide = [str(self._scenes / job.request["scene"]), str(self._files.folder(job.id))]
        problem = of_error(error, hide)
        if problem.status >= 500:
            log.exception("fault", extra={"job": job.id})
        self._queue.finish(claim, "failed", error=problem.document())

    def _leave(self, claim: Claim, why: str) -> None:
        if why == "cancel":
            self._queue.finish(claim, "cancelled")
        elif why == "deadline":
            late = ProblemError(504, "deadline_s: the job was not done by its deadline")
            self._queue.finish(claim, "failed", error=late.document())
        elif why == "stop":
            self._queue.release(claim)

    def _relit(self, claim: Claim, stopping: Stopping) -> dict[str, Any]:
        job, request = claim.job, claim.job.request
        began = time.perf_counter()
        hits = self._cache.hits
        scene = self._cache.load(request["scene"], self._scenes / request["scene"])
        guides = guides_of(
            request["lights"], scene, lambda n, kind: self._files.drawing(job.id, n, kind)
        )
        negative = negative_of(request["negative"])
        task = plans.prepared(self._relighter, scene, guides, negative, request)
        self._queue.tell(claim, plan=plans.plan_report(task))
        watcher = _Watcher(self, claim, stopping, task)
        watcher.check()
        if request["sweep"]:
            image, report = self._sheet(watcher, task, scene.object_mask, job)
        else:
            result = watcher.drain(self._relighter.start(task))
            image, report = result.image, result.report()
        began_writing = time.perf_counter()
        self._write(job.id, image)
        now = time.perf_counter()
        return {
            **report,
            "request": job.digest,
            "scene_cached": self._cache.hits > hits,
            "seconds_in_all": round(now - began, 4),
            "seconds_writing": round(now - began_writing, 4),
        }

    def _sheet(
        self, watcher: _Watcher, task: Any, mask: FloatArray, job: Job
    ) -> tuple[FloatArray, dict[str, Any]]:
        lights = job.request["lights"]
        tiles: list[Tile] = []
        reports: list[dict[str, Any]] = []
        for each in self._relighter.start_each(task):
            if isinstance(each, RelightResult):
                self._write(job.id, each.image, len(tiles))
                text = caption(lights[len(tiles)], len(tiles))
                tiles.append(make_tile(each.image, each.guides[0].positive, mask, text))
                reports.append(each.report())
            else:
                watcher.step(each)
        return contact_sheet(tiles), {**reports[0], "pictures": reports}

    def _write(self, job: str, image: FloatArray, light: int | None = None) -> None:
        self._files.write(self._files.picture(job, light), encode_png(image))
        with replacing(self._files.pixels(job, light)) as partial, partial.open("wb") as file:
            np.save(file, image.astype(np.float16))

    @contextmanager
    def _alive(self, claim: Claim) -> Iterator[None]:
        """Give signs of life however long a step takes."""
        over = threading.Event()

        def beat() -> None:
            while not over.wait(self._lease / BEATS):
                self._queue.beat(claim)

        thread = threading.Thread(target=beat, name="signs of life", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def verdict(self, claim: Claim, stopping: Stopping) -> None:
        """Raise unless the job is to be gone on with."""
        verdict = self._queue.verdict(claim)
        if verdict != "go on":
            raise _LeftError(verdict)
        if stopping():
            raise _LeftError("stop")

    def tell(self, claim: Claim, **facts: Any) -> None:
        """See `WorkQueue.tell`."""
        self._queue.tell(claim, **facts)

    def show(self, claim: Claim, progress: Progress) -> None:
        """Write a look at the picture as it forms."""
        picture = self._relighter.preview_of(progress)
        path = self._files.preview(claim.job.id)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, picture, quality=PREVIEW_QUALITY)

    def watched(self, claim: Claim) -> bool:
        """See `WorkQueue.watched`."""
        return self._queue.watched(claim)


class _Watcher:
    """What happens between two steps: progress is written, previews are made, and it may end."""

    def __init__(self, engine: Engine, claim: Claim, stopping: Stopping, task: Any) -> None:
        self._engine, self._claim, self._stopping = engine, claim, stopping
        self._task, self._of = task, plans.evaluations_of(task)
        self._together = plans.together_of(task)
        self._done = self._previews = 0
        self._began = time.perf_counter()
        self._spent = 0.0

    def drain(self, run: Any) -> RelightResult:
        """Go through a run to its result."""
        while True:
            try:
                self.step(next(run))
            except StopIteration as stop:
                result: RelightResult = stop.value
                return result

    def check(self) -> None:
        """Raise unless the job is to be gone on with."""
        self._engine.verdict(self._claim, self._stopping)

    def step(self, progress: Progress) -> None:
        """Take note of one step."""
        self.check()
        self._done += plans.evaluations_at(self._task, progress)
        together = self._together[progress.light]
        elapsed = time.perf_counter() - self._began
        facts: dict[str, Any] = {
            "stage": progress.stage,
            "step": progress.step.index + 1,
            "steps": progress.steps,
            "light": progress.light,
            "lights": progress.lights,
            "together": together,
            "evaluations": self._done,
            "of": self._of,
            "seconds": round(elapsed, 3),
        }
        # Of lights that go together the first alone is shown: two in turns would flicker.
        shown = progress.light == together[0] and self._spent <= PREVIEW_SHARE * elapsed
        if shown and self._engine.watched(self._claim):
            start = time.perf_counter()
            self._engine.show(self._claim, progress)
            self._spent += time.perf_counter() - start
            self._previews += 1
            self._engine.tell(self._claim, progress=facts, preview=self._previews)
            return
        self._engine.tell(self._claim, progress=facts)
