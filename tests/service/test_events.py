"""Watching a job, and stopping it."""

from __future__ import annotations

import base64
import socket
import threading
import time

import httpx
import pytest

LIGHT = {"azimuth": 200.0, "elevation": 40.0}
LONG = 1000
"""Steps that take the tiny backbone some seconds."""


def states(events):
    return [event.data["state"] for event in events if "state" in event.data]


def until(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "never came to be"
        time.sleep(0.02)


def test_events_tell_a_job_from_its_beginning_to_its_end(client, scene):
    job = client.relight(scene, [LIGHT], model="tiny", steps=600)
    events = list(client.events(job))
    assert events[0].kind == "state"
    assert events[-1].kind == "done"
    assert states(events)[-1] == "done"
    steps = [event.data for event in events if event.kind == "progress"]
    done = [step["evaluations"] for step in steps]
    assert done == sorted(done)
    assert steps[-1]["of"] == events[-1].data["plan"]["evaluations"]
    assert {step["stage"] for step in steps} == {"relight", "no shadow"}
    previews = [event.data for event in events if event.kind == "preview"]
    assert previews, "somebody watched"
    head, _, picture = previews[0]["image"].partition(",")
    assert head == "data:image/jpeg;base64"
    assert base64.b64decode(picture).startswith(b"\xff\xd8")


@pytest.mark.parametrize(
    ("model", "steps", "together"), [("mini", 60, {(0, 1)}), ("tiny", 600, {(0,), (1,)})]
)
def test_progress_names_the_lights_that_share_calls(client, scene, model, steps, together):
    lights = [LIGHT, LIGHT | {"azimuth": 20.0}]
    job = client.relight(scene, lights, sweep=True, model=model, steps=steps)
    told = [event.data for event in client.events(job) if event.kind == "progress"]
    assert {step["lights"] for step in told} == {2}
    relit = [step for step in told if step["stage"] == "relight"]
    assert {tuple(step["together"]) for step in relit} == together
    assert all(step["light"] in step["together"] for step in relit)


def test_who_comes_late_is_told_the_end_at_once(client, scene):
    job = client.wait(client.relight(scene, [LIGHT], model="tiny"))
    events = list(client.events(job))
    assert [event.kind for event in events] == ["done"]


def test_many_may_watch_one_job(server, client, scene):
    job = client.relight(scene, [LIGHT], model="tiny", steps=100)
    ends = []

    def watch() -> None:
        with server.client() as own:
            ends.append(list(own.events(job))[-1].kind)

    threads = [threading.Thread(target=watch) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert ends == ["done"] * 8


def test_a_running_job_stops_at_the_end_of_its_step(client, scene):
    job = client.relight(scene, [LIGHT], model="tiny", steps=LONG)
    events = client.events(job)
    until(lambda: next(events).kind == "progress")
    assert client.cancel(job).state in ("running", "cancelled")
    kinds = [event.kind for event in events]
    assert kinds[-1] == "cancelled"
    ended = client.job(job)
    assert ended.state == "cancelled"
    assert ended.facts["progress"]["evaluations"] < ended.facts["progress"]["of"]


def test_a_waiting_job_is_cancelled_at_once_and_its_place_is_told(client, scene):
    first = client.relight(scene, [LIGHT], model="tiny", steps=LONG)
    second, third = (client.relight(scene, [LIGHT], model="tiny", seed=s) for s in (2, 3))
    assert client.job(third).facts["position"] >= 1
    assert client.job(third).facts["eta_s"] > 0
    assert client.cancel(second).state == "cancelled"
    client.cancel(first)
    assert client.wait(third).state == "done"
    assert client.cancel(third).state == "done"  # what has ended stays as it is


def test_a_deadline_ends_a_job(client, scene):
    job = client.wait(client.relight(scene, [LIGHT], model="tiny", steps=LONG, deadline_s=0.3))
    assert job.state == "failed"
    assert job.facts["error"]["status"] == 504


def test_who_waits_for_a_job_that_fails_is_told_why(server, scene):
    body = {"scene": scene.id, "lights": [LIGHT], "model": "tiny"}
    waiting = {"headers": {"Prefer": "wait=30"}, "timeout": 60}
    for changes, status in (
        ({"steps": LONG, "deadline_s": 0.3}, 504),
        ({"model": "broken"}, 500),
        ({"budget_s": 1e-6}, 422),
    ):
        answer = httpx.post(f"{server.address}/v1/relight", json={**body, **changes}, **waiting)
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == "application/problem+json"


def test_a_client_that_leaves_while_it_waits_cancels_its_job(server, client, scene):
    body = {"scene": scene.id, "lights": [LIGHT], "model": "tiny", "steps": LONG, "seed": 987}
    request = httpx.Request(
        "POST", f"{server.address}/v1/relight", json=body, headers={"Prefer": "wait=60"}
    )
    head = "".join(f"{name}: {value}\r\n" for name, value in request.headers.items())
    with socket.create_connection(("127.0.0.1", server.port)) as connection:
        connection.sendall(f"POST /v1/relight HTTP/1.1\r\n{head}\r\n".encode() + request.content)

        def begun():
            job = client.jobs(1)[0]
            return job.facts["request"]["options"]["seed"] == 987 and job.state == "running"

        until(begun)
    until(lambda: client.jobs(1)[0].state == "cancelled", seconds=10.0)


def test_a_client_that_leaves_an_event_stream_cancels_nothing(client, scene):
    job = client.relight(scene, [LIGHT], model="tiny", steps=100)
    events = client.events(job)
    next(events)
    events.close()
    assert client.wait(job).state == "done"


def test_events_of_anothers_job_are_not_there(server):
    answer = httpx.get(f"{server.address}/v1/jobs/{'0' * 32}/events")
    assert answer.status_code == 404


@pytest.mark.parametrize("accept", ["text/plain", "image/gif", "image/png;q=0"])
def test_formats_there_are_not(server, client, scene, accept):
    job = client.wait(client.relight(scene, [LIGHT], model="tiny"))
    address = f"{server.address}/v1/jobs/{job.id}/result"
    assert httpx.get(address, headers={"Accept": accept}).status_code == 406
