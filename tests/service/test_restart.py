"""Whatever is killed, every job is done, and done once."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sqlite3
import time

import pytest

from spotlight_runtime import Light, Relighter, RelightOptions, Scene
from spotlight_runtime.imaging.images import encode_png
from spotlight_service.serving import Service
from spotlight_service.settings import Settings

from .servers import Server

LIGHT = {"azimuth": 200.0, "elevation": 40.0}
LONG = {"steps": 1000}
"""By four lights: seconds, on any machine, in which to kill, stop or look."""


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "never came to be"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def service(tmp_path_factory, models):
    running = Server(tmp_path_factory.mktemp("restart") / "data", models, "--model=tiny").start()
    yield running
    running.stop()


def worker_of(server) -> int:
    query = "SELECT facts FROM workers"
    connection = sqlite3.connect(server.data / "service.db")
    (facts,) = connection.execute(query).fetchone()
    connection.close()
    return json.loads(facts)["pid"]


def finished(server) -> dict[str, list[int]]:
    """Attempts that the workers' logs say ended in a result, by job."""
    found: dict[str, list[int]] = {}
    for line in server.log.read_text().splitlines():
        record = json.loads(line)
        if record["message"] == "done":
            found.setdefault(record["job"], []).append(record["attempt"])
    return found


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_killed_with_ten_jobs_waiting_and_one_running(service, models, bundle):
    with service.client() as client:
        scene = client.upload(bundle)
        running = client.relight(scene, [LIGHT] * 4, model="tiny", **LONG)
        waiting = [client.relight(scene, [LIGHT], model="tiny", seed=seed) for seed in range(10)]
        until(lambda: (client.job(running).facts["progress"] or {}).get("step", 0) > 5)
        worker = worker_of(service)
    service.kill()
    until(lambda: gone(worker), 10.0)  # nobody goes on for a service that is dead
    service.start()
    with service.client() as client:
        ended = [client.wait(job) for job in (running, *waiting)]
        assert [job.state for job in ended] == ["done"] * 11
        assert ended[0].facts["attempt"] == 2
        assert [job.facts["attempt"] for job in ended[1:]] == [1] * 10
        pictures = [client.result(job) for job in ended]
    done = finished(service)
    assert all(done[job.id] == [job.facts["attempt"]] for job in ended)
    assert len({hashlib.sha256(picture).digest() for picture in pictures}) == 11
    relighter = Relighter.load(models / "tiny", threads=1)
    options = RelightOptions(seed=3)
    own = relighter.relight(Scene.load(bundle), Light(200.0, 40.0), options=options)
    assert pictures[1 + 3] == encode_png(own.image)


def test_a_killed_worker_is_replaced_and_its_job_done_again(service, bundle):
    with service.client() as client:
        scene = client.upload(bundle)
        job = client.relight(scene, [LIGHT] * 4, model="tiny", **LONG)
        until(lambda: client.job(job).facts["progress"] is not None)
        before = worker_of(service)
        os.kill(before, signal.SIGKILL)
        ended = client.wait(job)
        assert (ended.state, ended.facts["attempt"]) == ("done", 2)
        assert worker_of(service) != before
    assert finished(service)[job.id] == [2]


def test_a_stop_gives_the_running_job_back_unharmed(service, bundle):
    with service.client() as client:
        scene = client.upload(bundle)
        job = client.relight(scene, [LIGHT] * 4, model="tiny", **LONG)
        until(lambda: client.job(job).facts["progress"] is not None)
        events = client.events(job)
        next(events)
        service.process.send_signal(signal.SIGTERM)
        list(events)  # the stream ends, it is not cut
    service.stop()
    log = service.log.read_text()
    assert '"message": "stop"' in log
    assert '"message": "stopped"' in log
    service.start()
    with service.client() as client:
        ended = client.wait(job)
        assert (ended.state, ended.facts["attempt"]) == ("done", 1)


def test_results_are_kept_for_so_long_and_no_longer(tmp_path):
    service = Service.open(Settings(data=tmp_path, result_ttl_s=60.0))
    for job in ("a" * 32, "b" * 32):
        service.jobs.submit(job, "anna", "mini", {"scene": "s"}, "d", 60.0)
        service.files.write(service.files.picture(job), b"picture")
    service.queue.finish(service.queue.claim("w", "mini"), "done", report={})
    service.tidy()
    assert service.files.picture("a" * 32).exists()
    with service.database.writing() as connection:
        connection.execute("UPDATE jobs SET finished = finished - 61 WHERE state = 'done'")
    service.tidy()
    assert service.jobs.ids() == {"b" * 32}
    assert [path.name for path in service.files.root.iterdir()] == ["b" * 32]
    service.close()
