"""Many clients at once: everybody gets an answer, and nobody another's."""

from __future__ import annotations

import asyncio

import pytest

from spotlight_service.load import load

from .servers import Server


def loaded(server, bundle, **how):
    with server.client() as client:
        scene = client.upload(bundle)
    tally = asyncio.run(load(server.address, scene.facts, options={"model": "tiny"}, **how))
    summary = tally.summary()
    print(summary)
    assert summary["wrong"] == []
    assert summary["ends"]["done"] > 0
    return summary


def test_twenty_clients_for_a_moment(server, bundle):
    summary = loaded(server, bundle, clients=20, seconds=1.0, requests=12)
    assert summary["different_requests"] > 1


@pytest.mark.full
def test_two_hundred_clients_for_five_minutes(tmp_path, models, bundle):
    server = Server(tmp_path / "data", models, "--model=tiny", requests_per_minute=1_000_000)
    server.start()
    try:
        summary = loaded(server, bundle, clients=200, seconds=300.0, requests=24)
    finally:
        server.stop()
    assert "Traceback" not in server.log.read_text()
    assert summary["ends"]["turned away"] > 0
    assert summary["different_requests"] == 24
    assert summary["memory_mb_end"] < 1.1 * summary["memory_mb_middle"]
