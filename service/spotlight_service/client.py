"""A typed client; needs httpx and nothing of the engine.

::

    from spotlight_service.client import Client

    with Client("http://127.0.0.1:8471") as spotlight:
        scene = spotlight.compose("room.jpg", "chair.glb", at=(0.5, 0.8))
        job = spotlight.relight(scene, [{"azimuth": 135, "elevation": 45}])
        picture = spotlight.result(spotlight.wait(job))
"""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, Self

import httpx

__all__ = ["Client", "Event", "Job", "Scene", "ServiceError", "drawn"]

Format = Literal["png", "jpeg", "webp", "x-exr"]
Light = Mapping[str, Any]
"""As the API takes it: ``{"azimuth": 135, "elevation": 45}``, or what `drawn` makes."""
LOOK_S: Final = 0.2
"""Between two looks at a job that is waited for."""


class ServiceError(Exception):
    """The service says no.

    Attributes
    ----------
    status : int
    problem : dict
        RFC 9457 document: ``detail``, and ``errors`` with field, expected and got.
    retry_after : float, optional
        Seconds after which to try again.
    """

    def __init__(self, response: httpx.Response) -> None:
        self.status = response.status_code
        try:
            self.problem: dict[str, Any] = response.json()
        except ValueError:  # a proxy's page, say
            self.problem = {"detail": response.text[:200], "errors": []}
        told = response.headers.get("Retry-After", "")
        self.retry_after = float(told) if told.isdigit() else None
        super().__init__(f"{self.status}: {self.problem.get('detail')}")


@dataclass(frozen=True, slots=True)
class Scene:
    """A stored scene; ``facts`` is all the service says of it."""

    id: str
    width: int
    height: int
    facts: dict[str, Any] = field(repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Job:
    """A job as it was when it was asked for; ``facts`` is all the service says of it."""

    id: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    digest: str
    facts: dict[str, Any] = field(repr=False, compare=False)

    @property
    def final(self) -> bool:
        """Whether nothing will change any more."""
        return self.state in ("done", "failed", "cancelled")


@dataclass(frozen=True, slots=True)
class Event:
    """A server-sent event: ``state``, ``progress``, ``preview``, ``done`` and so on."""

    kind: str
    data: dict[str, Any]


class Client:
    """A connection to a service; close it, or use it in a ``with`` block.

    Parameters
    ----------
    address : str
        ``http://127.0.0.1:8471``.
    key : str, optional
        API key.
    timeout : float
        Seconds for one answer; waiting answers take what they wait longer.
    """

    def __init__(
        self,
        address: str = "http://127.0.0.1:8471",
        key: str | None = None,
        timeout: float = 60.0,
    ) -> None:
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        self._timeout = timeout
        self._http = httpx.Client(base_url=address, headers=headers, timeout=timeout)

    def __enter__(self) -> Self:
        """The client itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the connection."""
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def sample(self, name: str) -> Scene:
        """A scene that comes along with the service."""
        return _scene(self._asked("POST", "/v1/scenes", data={"sample": name}))

    def upload(self, bundle: str | Path) -> Scene:
        """A scene from a zipped bundle."""
        with Path(bundle).open("rb") as file:
            return _scene(self._asked("POST", "/v1/scenes", files={"bundle": file}))

    def compose(
        self,
        photo: str | Path,
        item: str | Path,
        *,
        at: tuple[float, float] = (0.5, 0.8),
        mask: str | Path | None = None,
        **placement: float | str | bool,
    ) -> Scene:
        """A scene of a photograph and a 3-D model or cut-out.

        Parameters
        ----------
        photo, item : str or Path
        at : (x, y)
            Where the object stands, in fractions of the picture.
        mask : str or Path, optional
            Of a cut-out without transparency.
        **placement
            ``yaw``, ``size``, ``height``, ``fov``, ``horizon``, ``camera_height``, ``variant``,
            ``occlusion``, as the API has them.
        """
        fields = {"at": f"{at[0]},{at[1]}", **{k: str(v) for k, v in placement.items()}}
        paths = {"photo": photo, "object": item, **({} if mask is None else {"mask": mask})}
        with ExitStack() as open_files:
            files = {n: open_files.enter_context(Path(p).open("rb")) for n, p in paths.items()}
            return _scene(self._asked("POST", "/v1/scenes", data=fields, files=files))

    def sketch(
        self, scene: Scene, lights: Sequence[Light], show: Literal["sketch", "shadow"] = "sketch"
    ) -> bytes:
        """A quick look at lights, or their guiding shadow; PNG."""
        body = {"lights": [dict(light) for light in lights], "show": show}
        return self._asked("POST", f"/v1/scenes/{scene.id}/shadow", json=body).content

    def relight(
        self,
        scene: Scene,
        lights: Sequence[Light],
        *,
        idempotency_key: str | None = None,
        **options: Any,
    ) -> Job:
        """Put a relight into the queue; options are the API's: ``plan``, ``seed`` and so on."""
        headers = {} if idempotency_key is None else {"Idempotency-Key": idempotency_key}
        body = _body(scene, lights, options)
        return _job(self._asked("POST", "/v1/relight", json=body, headers=headers))

    def relit(
        self, scene: Scene, lights: Sequence[Light], *, wait: int = 60, **options: Any
    ) -> bytes | Job:
        """The picture (PNG) if it is done within ``wait`` seconds, otherwise the job."""
        answer = self._asked(
            "POST",
            "/v1/relight",
            json=_body(scene, lights, options),
            headers={"Prefer": f"wait={wait}", "Accept": "image/png"},
            timeout=self._timeout + wait,
        )
        return answer.content if answer.status_code == 200 else _job(answer)

    def job(self, job: Job | str) -> Job:
        """A job as it is now."""
        return _job(self._asked("GET", f"/v1/jobs/{_id(job)}"))

    def jobs(self, limit: int = 50) -> list[Job]:
        """One's jobs, newest first."""
        answer = self._asked("GET", "/v1/jobs", params={"limit": limit})
        return [_job_of(facts) for facts in answer.json()["jobs"]]

    def wait(self, job: Job | str, timeout: float = 600.0) -> Job:
        """A job once it has ended.

        Raises
        ------
        TimeoutError
            If it has not, within ``timeout`` seconds.
        """
        until = time.monotonic() + timeout
        while not (latest := self.job(job)).final:
            if time.monotonic() > until:
                raise TimeoutError(f"job {latest.id}: expected an end within {timeout:g} s")
            time.sleep(LOOK_S)
        return latest

    def events(self, job: Job | str) -> Iterator[Event]:
        """What happens to a job, until it has ended; close the iterator to stop looking."""
        address = f"/v1/jobs/{_id(job)}/events"
        with self._http.stream("GET", address, timeout=self._timeout) as answer:
            if answer.is_error:
                answer.read()
                raise ServiceError(answer)
            kind = ""
            for line in answer.iter_lines():
                name, _, value = line.partition(": ")
                if name == "event":
                    kind = value
                elif name == "data":
                    yield Event(kind, json.loads(value))

    def result(self, job: Job | str, form: Format = "png", light: int | None = None) -> bytes:
        """The picture of a job that is done; of a sweep the sheet, or one light's picture.

        Raises
        ------
        ServiceError
            409 if it is not done, 404 if it has no such light.
        """
        headers = {"Accept": f"image/{form}"}
        query = "" if light is None else f"?light={light}"
        return self._asked("GET", f"/v1/jobs/{_id(job)}/result{query}", headers=headers).content

    def report(self, job: Job | str) -> dict[str, Any]:
        """How the picture came about."""
        return dict(self._asked("GET", f"/v1/jobs/{_id(job)}/report").json())

    def cancel(self, job: Job | str) -> Job:
        """Cancel a job; one that runs ends with its present step."""
        return _job(self._asked("DELETE", f"/v1/jobs/{_id(job)}"))

    def capabilities(self) -> dict[str, Any]:
        """Limits, plans and their times, samples."""
        return dict(self._asked("GET", "/v1/capabilities").json())

    def models(self) -> list[dict[str, Any]]:
        """The models there are."""
        return list(self._asked("GET", "/v1/models").json()["models"])

    def _asked(self, method: str, path: str, **how: Any) -> httpx.Response:
        answer = self._http.request(method, path, **how)
        if answer.is_error:
            raise ServiceError(answer)
        return answer


def drawn(
    shadow: str | Path | bytes, *, negative: str | Path | bytes | None = None, **how: Any
) -> dict[str, Any]:
    """A light by its drawn shadow: a picture, white where the shadow falls.

    Parameters
    ----------
    shadow : path or bytes
    negative : path or bytes, optional
        Shadow of the opposite light.
    **how
        ``softness``, ``invert``, ``weight``, ``colour``.
    """

    def text(picture: str | Path | bytes) -> str:
        data = picture if isinstance(picture, bytes) else Path(picture).read_bytes()
        return base64.b64encode(data).decode()

    opposite = {} if negative is None else {"negative": text(negative)}
    return {"shadow": text(shadow), **opposite, **how}


def _body(scene: Scene, lights: Sequence[Light], options: Mapping[str, Any]) -> dict[str, Any]:
    return {"scene": scene.id, "lights": [dict(light) for light in lights], **options}


def _scene(answer: httpx.Response) -> Scene:
    facts = answer.json()
    return Scene(facts["id"], facts["width"], facts["height"], facts)


def _job(answer: httpx.Response) -> Job:
    return _job_of(answer.json())


def _job_of(facts: dict[str, Any]) -> Job:
    return Job(facts["id"], facts["state"], facts["digest"], facts)


def _id(job: Job | str) -> str:
    return job if isinstance(job, str) else job.id
