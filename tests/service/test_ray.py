"""The same job contract on Ray Serve: two replicas, one killed in mid-job, nothing lost."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import sqlite3
import time

import pytest

from .servers import Server

LIGHT = {"azimuth": 200.0, "elevation": 40.0}

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="extra 'ray'"),
]


def rows(server, query):
    connection = sqlite3.connect(server.data / "service.db")
    found = connection.execute(query).fetchall()
    connection.close()
    return found


def until(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, "never came to be"
        time.sleep(0.05)
    return value


def test_a_killed_replica_loses_nothing(tmp_path, models, bundle, monkeypatch):
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    server = Server(
        tmp_path / "data",
        models,
        *("--model", "tiny", "--ray", "--replicas", "2"),
        warnings="default",
        patience=180.0,
        lease_s=4,
    )
    server.start()
    try:
        with server.client() as client:
            scene = client.upload(bundle)
            jobs = [
                client.relight(scene, [LIGHT], model="tiny", seed=s, steps=1000) for s in range(8)
            ]
            running = "SELECT id, worker FROM jobs WHERE state = 'running' AND progress NOT NULL"
            (killed, worker), _ = until(lambda: (f := rows(server, running)) and len(f) == 2 and f)
            facts = {w: json.loads(f) for w, f in rows(server, "SELECT id, facts FROM workers")}
            assert len(facts) == 2, "two replicas share the queue"
            os.kill(facts[worker]["pid"], signal.SIGKILL)
            ended = {job.id: client.wait(job) for job in jobs}
            assert [job.state for job in ended.values()] == ["done"] * 8
            assert ended[killed].facts["attempt"] == 2
            pictures = {client.result(job) for job in ended.values()}
            assert len(pictures) == 8
            done = rows(server, "SELECT count(*) FROM jobs WHERE state = 'done'")
            assert done == [(8,)]
            # Each finished once: a second end would have raised the revision after the first.
            assert {job.facts["attempt"] for job in ended.values()} <= {1, 2}
    finally:
        server.stop()
