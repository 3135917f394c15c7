"""The client against the running service, and the page that documents both."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import httpx
import numpy as np
import pytest

from spotlight_runtime.imaging.images import encode_png
from spotlight_service.client import Client, ServiceError, drawn

from .hostile import cutout, picture


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "never came to be"
        time.sleep(0.02)


PAGE = Path(__file__).parents[2] / "service" / "service.md"
LIGHT = {"azimuth": 200.0, "elevation": 40.0}


def test_a_photograph_and_a_cutout(client, tmp_path):
    (tmp_path / "photo.jpg").write_bytes(picture(".jpg", (96, 128)))
    (tmp_path / "object.png").write_bytes(cutout())
    place = {"at": (0.4, 0.9), "height": 0.3, "horizon": 0.2}
    scene = client.compose(tmp_path / "photo.jpg", tmp_path / "object.png", **place)
    left, _, right, bottom = scene.facts["object_box"]
    assert left < 0.4 < right
    assert bottom == pytest.approx(0.9, abs=0.05)
    again = client.compose(tmp_path / "photo.jpg", tmp_path / "object.png", **place)
    moved = client.compose(
        tmp_path / "photo.jpg", tmp_path / "object.png", **{**place, "at": (0.6, 0.9)}
    )
    assert again == scene
    assert moved.id != scene.id


def test_a_mask_instead_of_transparency(client, tmp_path):
    mask = np.zeros((64, 96), np.float32)
    mask[20:60, 30:60] = 1.0
    for name, data in (
        ("photo.jpg", picture(".jpg", (96, 128))),
        ("object.png", picture()),
        ("mask.png", encode_png(mask)),
    ):
        (tmp_path / name).write_bytes(data)
    scene = client.compose(
        *(tmp_path / "photo.jpg", tmp_path / "object.png"),
        mask=tmp_path / "mask.png",
        height=0.2,
        horizon=0.2,
    )
    assert scene.facts["coverage"] > 0.0


def test_what_the_client_can_ask(client):
    tiny, *others = client.models()
    assert [tiny["name"], *(model["name"] for model in others)] == ["tiny", "broken", "mini"]
    assert tiny["ready"]
    capabilities = client.capabilities()
    assert [plan["name"] for plan in capabilities["plans"]["tiny"]] == [
        "exact",
        "balanced",
        "draft",
    ]
    assert capabilities["limits"]["queue"] == 32
    assert "goblet" in capabilities["samples"]


def test_problems_are_errors_with_their_document(client, scene, drawing):
    with pytest.raises(ServiceError, match="elevation") as caught:
        client.relight(scene, [{"azimuth": 0, "elevation": 100}], model="tiny")
    assert caught.value.status == 422
    with pytest.raises(ServiceError, match="negative"):
        client.relight(scene, [drawn(drawing)], model="tiny", negative="none")
    with pytest.raises(ServiceError) as caught:
        list(client.events("0" * 32))
    assert caught.value.status == 404


def test_a_full_queue_says_when_to_come_back(client, scene):
    made = [client.relight(scene, [LIGHT], model="tiny", steps=1000)]
    try:
        with pytest.raises(ServiceError) as caught:
            made.extend(client.relight(scene, [LIGHT], model="tiny", seed=s) for s in range(40))
        assert caught.value.status == 429
        assert caught.value.retry_after >= 1
        assert caught.value.problem["wait_s"] > 0
    finally:
        for job in client.jobs(50):
            client.cancel(job)
    until(lambda: client.job(made[0]).final)
    assert client.wait(client.relight(scene, [LIGHT], model="tiny")).state == "done"


def test_the_inference_protocol(server):
    get = lambda path: httpx.get(server.address + path)  # noqa: E731
    assert get("/v2").json()["name"] == "spotlight-serve"
    assert get("/v2/models").json() == {"models": ["tiny", "broken", "mini"]}
    assert get("/v2/models/tiny").json()["inputs"][0]["datatype"] == "BYTES"
    assert get("/v2/models/tiny/ready").json() == {"name": "tiny", "ready": True}
    assert get("/v2/health/live").json() == {"live": True}


def test_metrics_count_what_was_done(server, client, scene):
    def value(name):
        text = httpx.get(f"{server.address}/metrics").text
        found = re.search(rf"^{re.escape(name)} ([0-9.e+]+)$", text, re.M)
        return 0.0 if found is None else float(found[1])

    ended = 'spotlight_jobs_ended_total{model="tiny",state="done"}'
    evaluations = 'spotlight_evaluations_total{model="tiny"}'
    before = value(ended), value(evaluations)
    job = client.wait(client.relight(scene, [LIGHT], model="tiny", seed=31))
    report = client.report(job)
    assert value(ended) == before[0] + 1
    assert value(evaluations) == before[1] + report["evaluations"]
    assert value('spotlight_workers{model="tiny"}') == 1
    again = client.wait(client.relight(scene, [{**LIGHT, "azimuth": 90}], model="tiny", seed=31))
    assert client.report(again)["evaluations"] < report["evaluations"], "its plain pass was known"
    assert value('spotlight_plain_pass_reused_total{model="tiny"}') >= 1
    for method in ("MADEUP1", "MADEUP2"):
        httpx.request(method, f"{server.address}/v1/models")
    assert "MADEUP" not in httpx.get(f"{server.address}/metrics").text


def test_the_pages_python_runs(server, tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    code = code.replace("http://127.0.0.1:8471", server.address)
    code = code.replace('plan="draft"', 'plan="draft", model="tiny"')
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "done" in done.stdout
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


def test_the_pages_shell_runs(server, tmp_path):
    """Every line that needs no file of the reader's, with what jq does done by Python."""
    (block,) = re.findall(r"## From a shell\n\n```sh\n(.*?)```", PAGE.read_text(), re.S)
    lines = [line for line in block.splitlines() if "chair" not in line]
    script = "\n".join(lines).replace("http://127.0.0.1:8471", server.address)
    script = script.replace('"lights"', '"model": "tiny", "lights"')
    script = script.replace('/shadow --json \'{"model": "tiny", ', "/shadow --json '{")
    script = script.replace("jq -r .id", f"{sys.executable} -c '{JQ}'")
    as_json = "-H content-type:application/json -H accept:application/json -d '"
    script = script.replace("--json '", as_json)  # older curls
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "event: done" in done.stdout
    for name, magic in (("sketch.png", b"\x89PNG"), ("out.png", b"\x89PNG"), ("out.webp", b"RIFF")):
        assert (tmp_path / name).read_bytes().startswith(magic), name


JQ = 'import json, sys; print(json.load(sys.stdin)["id"])'


def test_the_client_needs_no_engine():
    code = (
        "import sys, spotlight_service.client; "
        "assert not {'spotlight_runtime', 'onnxruntime', 'fastapi'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_client_without_a_service():
    with Client("http://127.0.0.1:9", timeout=2.0) as client, pytest.raises(httpx.ConnectError):
        client.models()


@pytest.mark.full
def test_the_embedded_renderer_through_rest_costs_little_more_than_the_library(tmp_path, models):
    from .servers import Server

    server = Server(tmp_path / "data", models, "--model", "mini").start()
    try:
        with server.client() as client:
            scene = client.sample("goblet")
            shares = []
            for seed in range(4):
                answer = httpx.post(
                    f"{server.address}/v1/relight",
                    json={"scene": scene.id, "lights": [LIGHT], "seed": seed},
                    headers={"Prefer": "wait=120"},
                    timeout=180,
                )
                assert answer.headers["content-type"] == "image/png"
                report = client.report(answer.headers["Spotlight-Job"])
                library = sum(report["seconds"].values())
                shares.append(answer.elapsed.total_seconds() / library - 1.0)
            print("overhead of REST:", shares)
            assert min(shares[1:]) < 0.05
    finally:
        server.stop()


def test_the_embedded_renderer_answers(server, client):
    scene = client.sample("goblet")
    made = client.relit(scene, [LIGHT], model="mini", plan="draft", wait=100)
    assert isinstance(made, bytes)
    before = httpx.get(f"{server.address}/v1/scenes/{scene.id}/picture").content
    assert made != before
