"""``python -m spotlight_service.load``: many clients, each result checked against its request.

Every client makes a request, is turned away or given a job, watches it by polling or by events,
and checks that what it gets was made for what it asked: by the digest that comes with the picture,
and by the pixels, which have to be the same for the same request and differ between requests. Some
cancel, some leave while they wait.
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import json
import random
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import httpx

from spotlight_service.schemas import RelightRequest
from spotlight_service.submission import request_digest

__all__ = ["Tally", "load", "main"]

POLL_S: Final = 0.5
PROBE: Final = """
import http.client, json, sys, time
host, path, until = sys.argv[1], sys.argv[2], time.monotonic() + float(sys.argv[3])
connection, took = http.client.HTTPConnection(host, timeout=60), []
while time.monotonic() < until:
    began = time.perf_counter()
    connection.request("GET", path)
    connection.getresponse().read()
    took.append(time.perf_counter() - began)
    time.sleep(0.05)
print(json.dumps(took))
"""
"""Looks at a job from a process of its own: the crowd is one process, and busy with itself."""
LONGEST_PAUSE_S: Final = 5.0
"""Clients that are told to come back much later come back sooner than that: it is a load test."""
CANCELLED, LEFT, WATCHED = 0.1, 0.05, 0.3
"""Shares of clients that cancel, that leave while they wait, and that watch events."""
TOLD: Final = {200, 202, 404, 409, 429, 503, 507}
"""Statuses that are an answer; anything else is a failure."""


@dataclass
class Tally:
    """What a load test has seen.

    Attributes
    ----------
    ends : Counter
        Requests by how they ended.
    wrong : list of str
        What must not happen.
    looks : list of float
        Seconds of ``GET /v1/jobs/{id}``, twenty times a second.
    pictures : dict
        SHA-256 of the picture by request.
    memory : list of float
        Bytes the service's processes held, once a second.
    """

    ends: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    looks: list[float] = field(default_factory=list)
    pictures: dict[int, str] = field(default_factory=dict)
    memory: list[float] = field(default_factory=list)

    def check(self, number: int, digest: str, told: str, picture: bytes) -> None:
        """Note a result, and whether it was its own request's."""
        if digest != told:
            self.wrong.append(f"request {number}: the result of {told}, expected {digest}")
        found = hashlib.sha256(picture).hexdigest()
        if self.pictures.setdefault(number, found) != found:
            self.wrong.append(f"request {number}: two pictures")
        self.ends["done"] += 1

    def summary(self) -> dict[str, Any]:
        """For a person and for tests."""
        if len(set(self.pictures.values())) != len(self.pictures):
            self.wrong.append("different requests have the same picture")
        looks = sorted(self.looks) or [0.0]
        third = max(1, len(self.memory) // 3)
        early, late = self.memory[third : 2 * third], self.memory[-third:]
        return {
            "ends": dict(self.ends),
            "different_requests": len(self.pictures),
            "wrong": self.wrong[:20],
            "looks": len(self.looks),
            "look_ms_p50": round(1000 * looks[len(looks) // 2], 2),
            "look_ms_p99": round(1000 * looks[int(0.99 * (len(looks) - 1))], 2),
            "look_ms_max": round(1000 * looks[-1], 2),
            "memory_mb_middle": round(max(early, default=0.0) / 1e6, 1),
            "memory_mb_end": round(max(late, default=0.0) / 1e6, 1),
        }


async def load(
    address: str,
    scene: dict[str, Any],
    *,
    clients: int,
    seconds: float,
    requests: int,
    options: dict[str, Any],
    seed: int = 1,
) -> Tally:
    """Put a service under load.

    Parameters
    ----------
    address : str
    scene : dict
        As ``POST /v1/scenes`` answers.
    clients : int
    seconds : float
        After which nobody begins anything new.
    requests : int
        How many different ones there are.
    options : dict
        Further fields of every request: ``model``, ``steps``.
    seed : int
    """
    tally, until = Tally(), time.monotonic() + seconds
    bodies = [
        {
            "scene": scene["id"],
            "lights": [{"azimuth": 360.0 * i / requests, "elevation": 45.0}],
            "seed": i,
            **options,
        }
        for i in range(requests)
    ]
    asked = [(body, request_digest(RelightRequest(**body), [])[0]) for body in bodies]
    limits = httpx.Limits(max_connections=clients + 50, max_keepalive_connections=clients)
    async with httpx.AsyncClient(base_url=address, timeout=120.0, limits=limits) as http:
        watching = asyncio.create_task(_memory(http, tally))
        first = (await http.post("/v1/relight", json=bodies[0])).json()["id"]
        where = (address.removeprefix("http://"), f"/v1/jobs/{first}", str(seconds))
        probe = await asyncio.create_subprocess_exec(
            *(sys.executable, "-c", PROBE, *where), stdout=asyncio.subprocess.PIPE
        )
        crowd = [
            asyncio.create_task(_client(http, tally, asked, until, random.Random(seed * 7919 + i)))
            for i in range(clients)
        ]
        await asyncio.gather(*crowd)
        told, _ = await probe.communicate()
        tally.looks = json.loads(told)
        watching.cancel()
    return tally


async def _client(
    http: httpx.AsyncClient,
    tally: Tally,
    asked: list[tuple[dict[str, Any], str]],
    until: float,
    chance: random.Random,
) -> None:
    await asyncio.sleep(chance.uniform(0.0, 2.0))
    while time.monotonic() < until:
        number = chance.randrange(len(asked))
        try:
            pause = await _one(http, tally, number, *asked[number], chance)
        except httpx.HTTPError as error:
            tally.wrong.append(f"request {number}: {type(error).__name__} {error}")
            pause = 1.0
        await asyncio.sleep(pause)


async def _one(
    http: httpx.AsyncClient,
    tally: Tally,
    number: int,
    body: dict[str, Any],
    digest: str,
    chance: random.Random,
) -> float:
    """One request from its beginning to its end; returns the pause before the next."""
    if chance.random() < LEFT:
        try:
            await http.post("/v1/relight", json=body, headers={"Prefer": "wait=60"}, timeout=1.0)
        except httpx.TimeoutException:
            tally.ends["left"] += 1
        return 0.5
    answer = await http.post("/v1/relight", json=body)
    if answer.status_code == 429:
        tally.ends["turned away"] += 1
        told = float(answer.headers["Retry-After"])
        return min(told, LONGEST_PAUSE_S) * chance.uniform(0.8, 1.2)
    if answer.status_code != 202:
        _unexpected(tally, "POST /v1/relight", answer)
        return 1.0
    job = answer.json()["id"]
    if chance.random() < CANCELLED:
        await asyncio.sleep(chance.uniform(0.0, 3.0))
        _unexpected(tally, "DELETE", await http.delete(f"/v1/jobs/{job}"))
    if chance.random() < WATCHED:
        async with http.stream("GET", f"/v1/jobs/{job}/events") as events:
            async for _ in events.aiter_lines():
                pass
    while True:
        look = await http.get(f"/v1/jobs/{job}")
        _unexpected(tally, "GET /v1/jobs", look)
        state = look.json().get("state")
        if state in ("done", "cancelled", "failed"):
            break
        await asyncio.sleep(POLL_S * chance.uniform(0.8, 1.2))
    if state != "done":
        tally.ends[state] += 1
        if state == "failed":
            tally.wrong.append(f"request {number}: {look.json()['error']['detail']}")
        return 0.1
    while (result := await http.get(f"/v1/jobs/{job}/result")).status_code == 429:
        await asyncio.sleep(float(result.headers["Retry-After"]))
    _unexpected(tally, "GET result", result)
    tally.check(number, digest, result.headers.get("Spotlight-Request", ""), result.content)
    return 0.1


def _unexpected(tally: Tally, what: str, answer: httpx.Response) -> None:
    if answer.status_code not in TOLD:
        tally.wrong.append(f"{what}: {answer.status_code} {answer.text[:200]}")


async def _memory(http: httpx.AsyncClient, tally: Tally) -> None:
    while True:
        try:
            lines = (await http.get("/metrics")).text.splitlines()
            held = [float(li.split()[-1]) for li in lines if li.startswith("spotlight_resident_b")]
            tally.memory.append(sum(held))
        except (httpx.HTTPError, ValueError, IndexError):
            pass  # the other answers tell if something is wrong
        await asyncio.sleep(1.0)


def main() -> None:
    """Entry point: a summary as JSON; exit code 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m spotlight_service.load", description=__doc__)
    parser.add_argument("--address", default="http://127.0.0.1:8471")
    parser.add_argument("--sample", default="goblet", help="scene that comes along")
    parser.add_argument("--bundle", type=Path, help="instead: a zipped scene")
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--requests", type=int, default=24, help="different ones")
    parser.add_argument("--options", type=json.loads, default={}, help='JSON: {"steps": 4}')
    given = parser.parse_args()
    if given.bundle is None:
        how: dict[str, Any] = {"data": {"sample": given.sample}}
    else:
        how = {"files": {"bundle": given.bundle.read_bytes()}}
    made = httpx.post(f"{given.address}/v1/scenes", timeout=120.0, **how)
    made.raise_for_status()
    tally = asyncio.run(
        load(
            given.address,
            made.json(),
            clients=given.clients,
            seconds=given.seconds,
            requests=given.requests,
            options=given.options,
        )
    )
    summary = tally.summary()
    print(json.dumps(summary, indent=2))
    sys.exit(1 if summary["wrong"] else 0)


if __name__ == "__main__":
    main()
