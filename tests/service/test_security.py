"""Keys, scopes, rates, origins, headers, and what the log must not hold."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys

import httpx
import pytest
from typer.testing import CliRunner

from spotlight_service.client import ServiceError
from spotlight_service.command import app as command
from spotlight_service.problems import ProblemError
from spotlight_service.security.keys import KeyStore
from spotlight_service.security.rates import RateLimiter
from spotlight_service.storage.database import Database

from .servers import Server

LIGHT = {"azimuth": 200.0, "elevation": 40.0}


def make_key(data, name, scopes=("read", "write"), per_minute=None):
    database = Database(data / "service.db")
    key = KeyStore(database).create(name, scopes, per_minute)
    database.close()
    return key


@pytest.fixture(scope="module")
def locked(tmp_path_factory, models):
    """A service that needs keys, and keys for it."""
    data = tmp_path_factory.mktemp("locked") / "data"
    keys = {
        "anna": make_key(data, "anna"),
        "bert": make_key(data, "bert"),
        "viewer": make_key(data, "viewer", ["read"]),
        "slow": make_key(data, "slow", per_minute=3),
        "prometheus": make_key(data, "prometheus", ["metrics"]),
    }
    running = Server(data, models, "--model", "tiny").start()
    yield running, keys
    running.stop()
    log = running.log.read_text()
    for key in keys.values():
        assert key.split("_", 2)[2] not in log, "a secret is in the log"


def test_without_a_key_nothing_is_told(locked, bundle):
    server, _ = locked
    for path in ("/v1/jobs", "/v1/models", "/v1/capabilities", "/metrics", "/v2"):
        answer = httpx.get(server.address + path)
        assert answer.status_code == 401, path
        assert answer.headers["WWW-Authenticate"] == "Bearer"
        assert answer.json()["errors"][0]["field"] == "Authorization"
    for key in ("spotlight_x_y", "nonsense", "spotlight__", "spotlight_" + "a" * 5000, "ünï"):
        headers = {"Authorization": f"Bearer {key}".encode()}
        assert httpx.get(f"{server.address}/v1/jobs", headers=headers).status_code == 401
    with bundle.open("rb") as file:
        sent = httpx.post(f"{server.address}/v1/scenes", files={"bundle": file})
    assert sent.status_code == 401


def test_health_and_page_need_no_key(locked):
    server, _ = locked
    for path in ("/v2/health/live", "/v2/health/ready", "/", "/openapi.json"):
        assert httpx.get(server.address + path).status_code == 200, path


def test_results_are_for_the_key_that_made_them(locked, bundle):
    server, keys = locked
    with server.client(keys["anna"]) as anna, server.client(keys["bert"]) as bert:
        scene = anna.upload(bundle)
        job = anna.wait(anna.relight(scene, [LIGHT], model="tiny"))
        assert anna.result(job)
        for steal in (
            bert.job,
            bert.result,
            bert.report,
            bert.cancel,
            lambda j: list(bert.events(j)),
        ):
            with pytest.raises(ServiceError) as caught:
                steal(job)
            assert caught.value.status == 404
        with pytest.raises(ServiceError) as caught:
            bert.relight(scene, [LIGHT], model="tiny")
        assert caught.value.status == 404
        assert bert.jobs() == []
        own = bert.upload(bundle)  # who has the content may have the scene
        assert own.id == scene.id
        assert bert.wait(bert.relight(own, [LIGHT], model="tiny")).state == "done"


def test_scopes(locked, bundle):
    server, keys = locked
    with server.client(keys["viewer"]) as viewer:
        assert viewer.jobs() == []
        with pytest.raises(ServiceError) as caught:
            viewer.upload(bundle)
        assert caught.value.status == 403
    headers = {"X-API-Key": keys["prometheus"]}
    answer = httpx.get(f"{server.address}/metrics", headers=headers)
    assert answer.status_code == 200
    assert "spotlight_workers" in answer.text
    assert httpx.get(f"{server.address}/v1/jobs", headers=headers).status_code == 403


def test_rates(locked):
    server, keys = locked
    headers = {"Authorization": f"Bearer {keys['slow']}"}
    answers = [httpx.get(f"{server.address}/v1/models", headers=headers) for _ in range(4)]
    assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
    assert 1 <= int(answers[-1].headers["Retry-After"]) <= 20
    with server.client(keys["viewer"]) as other:
        assert other.models()  # another's rate is another's


def test_revoked_keys_are_void_at_once(locked):
    server, _ = locked
    key = made_by_command(server.data, "add", "guest", "--scope", "read").stdout.strip()
    headers = {"Authorization": f"Bearer {key}"}
    assert httpx.get(f"{server.address}/v1/jobs", headers=headers).status_code == 200
    assert made_by_command(server.data, "revoke", key.split("_")[1]).exit_code == 0
    assert httpx.get(f"{server.address}/v1/jobs", headers=headers).status_code == 401
    assert "guest  revoked" in made_by_command(server.data, "list").stdout
    again = made_by_command(server.data, "revoke", "nobody")
    assert again.exit_code == 1
    assert "expected the id of a key" in again.stderr


def made_by_command(data, *arguments):
    return CliRunner().invoke(command, ["keys", *arguments, "--data", str(data)])


def test_no_secret_is_stored(locked):
    server, keys = locked
    with sqlite3.connect(server.data / "service.db") as connection:
        stored = str(connection.execute("SELECT * FROM keys").fetchall())
    connection.close()
    for key in keys.values():
        assert key.split("_")[1] in stored
        assert key.split("_", 2)[2] not in stored


def test_beyond_this_machine_keys_are_needed(tmp_path, models):
    started = [sys.executable, "-m", "spotlight_service", "--host", "0.0.0.0", "--port", "0"]
    done = subprocess.run(
        [*started, "--data", str(tmp_path / "data")],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1
    assert "loopback" in done.stderr
    assert "keys add" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_pages_elsewhere_cannot_use_a_service_without_keys(server):
    for headers, status in (
        ({"Host": "evil.example"}, 421),
        ({"Host": "127.0.0.1.evil.example"}, 421),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": server.address}, 200),
        ({"Host": f"localhost:{server.port}"}, 200),
        ({"Host": f"[::1]:{server.port}"}, 200),
    ):
        answer = httpx.get(f"{server.address}/v1/models", headers=headers)
        assert answer.status_code == status, headers


def test_two_services_do_not_share_a_folder(server, models):
    second = Server(server.data, models, "--model", "tiny")
    second.log = server.data.parent / "second.log"
    with pytest.raises(AssertionError, match="another service uses this data folder"):
        second.start()


@pytest.mark.parametrize("path", ["/", "/v1/models", "/v1/nothing", "/metrics", "/openapi.json"])
def test_headers_of_every_answer(server, path):
    answer = httpx.get(server.address + path)
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["X-Frame-Options"] == "DENY"
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert "server" not in answer.headers
    assert answer.headers["x-request-id"]


@pytest.mark.parametrize("path", ["/", "/main.js", "/base.css", "/icon.svg"])
def test_the_page_is_asked_for_anew_and_sent_again_only_if_it_changed(server, path):
    first = httpx.get(server.address + path)
    assert first.headers["Cache-Control"] == "no-cache"
    again = httpx.get(server.address + path, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["Cache-Control"] == "no-cache"
    assert again.headers["ETag"] == first.headers["ETag"]
    assert httpx.get(f"{server.address}/v1/models").headers["Cache-Control"] == "no-store"


def test_the_log_has_every_request_by_its_id_as_json(server):
    httpx.get(f"{server.address}/v1/models?token=geheim", headers={"X-Request-ID": "mine-42"})
    httpx.get(f"{server.address}/v1/models", headers={"X-Request-ID": "zweizeilen\t{}"})
    lines = [json.loads(line) for line in server.log.read_text().splitlines()]
    (mine,) = [line for line in lines if line.get("request") == "mine-42"]
    assert (mine["status"], mine["message"]) == (200, "GET /v1/models")
    assert "geheim" not in server.log.read_text()
    assert "zweizeilen" not in server.log.read_text()


def test_a_bucket_fills_evenly():
    now = [0.0]
    limiter = RateLimiter(60, clock=lambda: now[0])
    for _ in range(60):
        limiter.take("anna")
    with pytest.raises(ProblemError) as caught:
        limiter.take("anna")
    assert caught.value.headers["Retry-After"] == "1"
    now[0] += 1.0
    limiter.take("anna")
    with pytest.raises(ProblemError):
        limiter.take("anna")
    limiter.take("bert")


def test_keys_open_only_what_they_are_for(tmp_path):
    database = Database(tmp_path / "keys.db")
    keys = KeyStore(database)
    assert not keys.any()
    token = keys.create("anna", ["read"], per_minute=7)
    caller = keys.check(token)
    assert (caller.name, caller.scopes, caller.per_minute) == ("anna", frozenset({"read"}), 7)
    prefix, key, secret = token.split("_", 2)
    for wrong in (f"{prefix}_{key}_{secret[:-1]}", f"other_{key}_{secret}", f"{prefix}_{key}_", ""):
        assert keys.check(wrong) is None
    with pytest.raises(ProblemError, match="scope"):
        keys.create("x", ["everything"])
    assert keys.revoke(key)
    assert keys.check(token) is None
    assert keys.any(), "revoking the last key must not open the service"
    database.close()
