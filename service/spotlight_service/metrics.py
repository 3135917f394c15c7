"""What Prometheus reads: queue, durations by stage, evaluations, cache hits, memory."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from spotlight_service.memory import resident_bytes
from spotlight_service.storage.jobs import JobStore
from spotlight_service.storage.records import Job
from spotlight_service.storage.workers import WorkerBook

__all__ = ["Metrics"]

_METHODS: Final = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"}
_REQUEST_S: Final = (0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0)
_STAGE_S: Final = (0.01, 0.05, 0.2, 1.0, 5.0, 20.0, 100.0, 500.0)


class Metrics:
    """Counters of this process, and gauges read from the store when they are asked for.

    Parameters
    ----------
    store : JobStore
    book : WorkerBook
    """

    def __init__(self, store: JobStore, book: WorkerBook) -> None:
        self.registry = CollectorRegistry()
        self.registry.register(_Stored(store, book))
        self._requests = Histogram(
            "spotlight_request_seconds",
            "Time to answer, by route.",
            ("method", "route", "status"),
            buckets=_REQUEST_S,
            registry=self.registry,
        )
        self._stages = Histogram(
            "spotlight_stage_seconds",
            "Time of each stage of a relight.",
            ("model", "stage"),
            buckets=_STAGE_S,
            registry=self.registry,
        )
        self._ended = Counter(
            "spotlight_jobs_ended",
            "Jobs by how they ended.",
            ("model", "state"),
            registry=self.registry,
        )
        self._evaluations = Counter(
            "spotlight_evaluations", "Denoiser evaluations.", ("model",), registry=self.registry
        )
        self._reused = Counter(
            "spotlight_plain_pass_reused",
            "Relights that found the picture without shadow ready.",
            ("model",),
            registry=self.registry,
        )
        self._streams = Gauge(
            "spotlight_event_streams", "Open event streams.", registry=self.registry
        )

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count an answer."""
        known = method if method in _METHODS else "other"  # strangers make up any number of them
        self._requests.labels(known, route, str(status)).observe(seconds)

    def streaming(self, change: int) -> None:
        """Count an event stream that opens (1) or closes (-1)."""
        self._streams.inc(change)

    def changed(self, job: Job) -> None:
        """Count a job that has ended."""
        if not job.final:
            return
        self._ended.labels(job.model, job.state).inc()
        if job.report is None:
            return
        reports = job.report.get("pictures", [job.report])
        for report in reports:
            self._evaluations.labels(job.model).inc(report["evaluations"])
        for stage, seconds in reports[-1]["seconds"].items():
            self._stages.labels(job.model, stage).observe(seconds)
        self._stages.labels(job.model, "all").observe(job.report["seconds_in_all"])
        self._stages.labels(job.model, "queue").observe((job.started or 0.0) - job.created)
        if not report_runs_plain(reports[0]):
            self._reused.labels(job.model).inc()


def report_runs_plain(report: dict[str, object]) -> bool:
    """Whether the pass without shadow was run for a picture."""
    seconds = report["seconds"]
    return isinstance(seconds, dict) and "no shadow" in seconds


class _Stored(Collector):
    """Gauges of what is in the store."""

    def __init__(self, store: JobStore, book: WorkerBook) -> None:
        self._store, self._book = store, book

    def collect(self) -> Iterable[Metric]:
        """Read them."""
        jobs = GaugeMetricFamily("spotlight_jobs", "Jobs by state.", labels=("model", "state"))
        for (model, state), many in self._store.counts().items():
            jobs.add_metric((model, state), many)
        yield jobs
        workers = GaugeMetricFamily("spotlight_workers", "Living workers.", labels=("model",))
        memory = GaugeMetricFamily(
            "spotlight_resident_bytes", "Memory held, by process.", labels=("process", "pid")
        )
        memory.add_metric(("api", "self"), resident_bytes())
        cached = GaugeMetricFamily(
            "spotlight_scene_cache", "Scene cache of a worker.", labels=("pid", "what")
        )
        for model, found in self._book.living().items():
            workers.add_metric((model,), len(found))
            for facts in found:
                pid = str(facts["pid"])
                memory.add_metric(("worker", pid), facts["resident_bytes"])
                for what, value in facts["scene_cache"].items():
                    cached.add_metric((pid, what), value)
        yield from (workers, memory, cached)
