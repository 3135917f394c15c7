"""What answers look like."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from spotlight_service.storage.jobs import JobStore
from spotlight_service.storage.records import Job
from spotlight_service.storage.scene_info import SceneInfo

__all__ = ["JobList", "JobView", "ProblemView", "SceneView", "job_view", "scene_view"]


class Wrong(BaseModel):
    """One field that is wrong."""

    field: str
    expected: str
    got: str


class ProblemView(BaseModel):
    """A problem, after RFC 9457."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: list[Wrong] = []
    request: str | None = Field(None, description="Id of the request, as the log has it.")
    wait_s: float | None = Field(None, description="Present wait of the queue, where it is full.")


class SceneView(BaseModel):
    """A stored scene."""

    id: str
    name: str
    width: int
    height: int
    field_of_view: float
    object_box: list[float] = Field(
        min_length=4,
        max_length=4,
        description="left, top, right, bottom of the object, in fractions of the picture.",
    )
    coverage: float
    floor_normal: Annotated[list[float], Field(min_length=3, max_length=3)] | None = Field(
        description="Upwards; x right, y up, z towards the camera."
    )
    casts: bool = Field(description="Whether lights cast shadows here; else draw them.")
    summary: str
    links: dict[str, str]


class Progress(BaseModel):
    """How far a job is."""

    stage: Literal["relight", "no shadow"]
    step: int
    steps: int
    light: int
    lights: int
    together: list[int] = Field(
        default=[], description="Lights that go through the network together with this one."
    )
    evaluations: int
    of: int
    seconds: float
    fraction: float


class JobView(BaseModel):
    """A job."""

    id: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    cancelling: bool
    model: str
    scene: str
    request: dict[str, Any] = Field(description="What was asked for; drawings by their SHA-256.")
    digest: str = Field(description="SHA-256 of the request, which the result names, too.")
    position: int | None = Field(description="Jobs that will be begun before it, while it waits.")
    eta_s: float | None = Field(description="Seconds until it is done, as far as can be told.")
    progress: Progress | None
    plan: dict[str, Any] | None = Field(description="What runs and why, once it has begun.")
    error: ProblemView | None
    seconds: float | None = Field(description="From its beginning to its end.")
    attempt: int
    created: datetime
    started: datetime | None
    finished: datetime | None
    deadline: datetime
    links: dict[str, str]


class JobList(BaseModel):
    """A caller's jobs, newest first."""

    jobs: list[JobView]


def scene_view(info: SceneInfo) -> SceneView:
    """A scene as an answer."""
    base = f"/v1/scenes/{info.id}"
    facts = {name: getattr(info, name) for name in SceneView.model_fields if name != "links"}
    for name in ("object_box", "floor_normal"):
        facts[name] = None if facts[name] is None else list(facts[name])
    links = {"self": base, "shadow": f"{base}/shadow", "picture": f"{base}/picture"}
    return SceneView(**facts, links=links)


def job_view(job: Job, store: JobStore) -> JobView:
    """A job as an answer."""
    position = store.position(job) if job.state == "queued" else None
    base = f"/v1/jobs/{job.id}"
    links = {"self": base, "events": f"{base}/events"}
    if job.state == "done":
        links |= {"result": f"{base}/result", "report": f"{base}/report"}
    return JobView(
        id=job.id,
        state=job.state,
        cancelling=job.cancelling and not job.final,
        model=job.model,
        scene=job.request["scene"],
        request=job.request,
        digest=job.digest,
        position=position,
        eta_s=_eta(job, position, store),
        progress=_progress(job),
        plan=job.plan,
        error=None if job.error is None else ProblemView(**job.error),
        seconds=_seconds(job),
        attempt=job.attempt,
        created=_time(job.created),
        started=None if job.started is None else _time(job.started),
        finished=None if job.finished is None else _time(job.finished),
        deadline=_time(job.deadline),
        links=links,
    )


def _eta(job: Job, position: int | None, store: JobStore) -> float | None:
    if position is not None:  # those before it, itself, and half of the one that runs
        return round(store.seconds(job.model) * (position + 1.5), 2)
    if job.state != "running":
        return None
    if not job.progress or not job.progress["evaluations"]:
        return round(store.seconds(job.model), 2)
    done, of = job.progress["evaluations"], job.progress["of"]
    left: float = job.progress["seconds"] / done * (of - done)
    return round(left, 2)


def _progress(job: Job) -> Progress | None:
    if job.progress is None:
        return None
    fraction = job.progress["evaluations"] / max(1, job.progress["of"])
    return Progress(**job.progress, fraction=round(min(1.0, fraction), 4))


def _seconds(job: Job) -> float | None:
    if job.started is None or job.finished is None:
        return None
    return round(job.finished - job.started, 3)


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
