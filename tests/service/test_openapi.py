"""What the document promises is kept: whatever is sent, no 5xx and nothing undocumented."""

from __future__ import annotations

import contextlib
import warnings

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from .servers import Server

CHECKS = (
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
)
FEW, MANY = 6, 150


def fuzzed(server: Server, examples: int, seed: int) -> set[str]:
    """Send whatever the document allows, and what it does not; returns what was reached."""
    schema = schemathesis.openapi.from_url(f"{server.address}/openapi.json")
    reached: set[str] = set()
    for result in schema.get_all_operations():
        operation = result.ok()
        if operation.path.endswith("/events"):
            continue  # streams, which have tests of their own

        def one(case) -> None:
            reached.add(f"{case.operation.method.upper()} {case.operation.path}")
            case.call_and_validate(checks=CHECKS, timeout=30)

        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            strategy = operation.as_strategy(generation_mode=mode)
            run = hypothesis_runner(strategy, one, examples, seed)
            with contextlib.suppress(Unsatisfiable):  # what takes nothing cannot be sent wrongly
                run()
    return reached


def hypothesis_runner(strategy, one, examples, seed):
    from hypothesis import given
    from hypothesis import seed as seeded

    @seeded(seed)
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=strategy)
    def run(case) -> None:
        one(case)

    return run


def check(server: Server, examples: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the fuzzer's own
        reached = fuzzed(server, examples, seed=1)
    assert "POST /v1/relight" in reached
    assert "POST /v1/scenes" in reached
    assert len(reached) >= 15


def test_nothing_undocumented_happens(server):
    check(server, FEW)


@pytest.mark.full
def test_nothing_undocumented_happens_in_many_tries(server):
    check(server, MANY)


def test_every_operation_says_what_it_does_and_how_it_fails(server):
    document = httpx.get(f"{server.address}/openapi.json").json()
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            assert operation.get("summary") or operation.get("description"), (method, path)
            for status, response in operation["responses"].items():
                if status[0] in "45":
                    assert list(response["content"]) == ["application/problem+json"]


def test_the_documents_examples_run(server):
    """As somebody would who copies them: the sample makes the scene, the example relights it."""
    document = httpx.get(f"{server.address}/openapi.json").json()
    scenes = document["paths"]["/v1/scenes"]["post"]["requestBody"]["content"]
    form = scenes["multipart/form-data"]["examples"]["sample"]["value"]
    scene = httpx.post(f"{server.address}/v1/scenes", data=form, timeout=60).json()
    (example,) = document["components"]["schemas"]["RelightRequest"]["examples"]
    body = {**example, "scene": scene["id"], "model": "tiny"}
    made = httpx.post(f"{server.address}/v1/relight", json=body)
    assert made.status_code == 202, made.text
    (example,) = document["components"]["schemas"]["ShadowRequest"]["examples"]
    shown = httpx.post(
        server.address + scene["links"]["shadow"], json={**example, "side": 64}, timeout=60
    )
    assert shown.headers["content-type"] == "image/png"
    httpx.delete(server.address + made.headers["Location"])
