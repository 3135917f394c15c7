"""The way of a picture through the service, and what it says to those who go astray."""

from __future__ import annotations

import json

import cv2
import httpx
import numpy as np
import pytest

from spotlight_runtime import Light, Relighter, RelightOptions, Scene
from spotlight_runtime.imaging.images import encode_png
from spotlight_runtime.planning.ladder import named_rung
from spotlight_service.client import ServiceError, drawn

LIGHT = {"azimuth": 200.0, "elevation": 40.0}


def decoded(data: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def test_the_same_scene_has_the_same_id_whoever_zips_it(client, bundle, scene):
    assert client.upload(bundle) == scene
    assert (scene.width, scene.height) == (96, 64)
    assert scene.facts["casts"]


def test_a_relight_is_the_librarys_to_the_byte(client, scene, models, bundle):
    job = client.wait(client.relight(scene, [LIGHT], model="tiny", seed=110_011))
    assert job.state == "done", job.facts["error"]
    relighter = Relighter.load(models / "tiny", threads=1)
    own = relighter.relight(
        Scene.load(bundle),
        Light(azimuth=200.0, elevation=40.0),
        options=RelightOptions(seed=110_011),
    )
    assert client.result(job) == encode_png(own.image)
    report = client.report(job)
    assert report["request"] == job.digest
    assert report["evaluations"] == own.evaluations


def test_waiting_gives_the_picture_itself(client, scene):
    picture = client.relit(scene, [LIGHT], model="tiny", wait=60)
    assert isinstance(picture, bytes)
    assert decoded(picture).shape == (64, 96, 3)


@pytest.mark.parametrize("accept", ["application/json", "Application/JSON", "*/*"])
def test_who_names_no_kind_of_picture_gets_png(server, scene, accept):
    """``curl --json`` names JSON by itself."""
    body = {"scene": scene.id, "lights": [LIGHT], "model": "tiny"}
    headers = {"Prefer": "wait=60", "Accept": accept}
    answer = httpx.post(f"{server.address}/v1/relight", json=body, headers=headers, timeout=90)
    assert answer.headers["content-type"] == "image/png"


def test_who_does_not_want_to_wait_that_long_gets_the_job(server, scene):
    body = {"scene": scene.id, "lights": [LIGHT] * 16, "model": "tiny", "steps": 1000}
    headers = {"Prefer": "respond-async, wait=1"}
    answer = httpx.post(f"{server.address}/v1/relight", json=body, headers=headers, timeout=30)
    assert answer.status_code == 202
    assert answer.headers["Location"] == f"/v1/jobs/{answer.json()['id']}"
    httpx.delete(server.address + answer.headers["Location"])


@pytest.mark.parametrize(
    ("accept", "kind", "magic"),
    [
        ("image/png", "image/png", b"\x89PNG"),
        ("image/jpeg", "image/jpeg", b"\xff\xd8"),
        ("image/webp", "image/webp", b"RIFF"),
        ("image/x-exr", "image/x-exr", b"\x76\x2f\x31\x01"),
        ("*/*", "image/png", b"\x89PNG"),
        ("text/html, image/webp;q=0.8, image/jpeg;q=0.9", "image/jpeg", b"\xff\xd8"),
    ],
)
def test_the_result_comes_in_the_format_that_is_liked_best(
    server, client, scene, accept, kind, magic
):
    job = client.wait(client.relight(scene, [LIGHT], model="tiny"))
    address = f"{server.address}/v1/jobs/{job.id}/result"
    answer = httpx.get(address, headers={"Accept": accept})
    assert answer.headers["content-type"] == kind
    assert answer.headers["Spotlight-Request"] == job.digest
    assert answer.content.startswith(magic)


def test_exr_is_linear(client, scene, tmp_path):
    from spotlight_runtime import read_image
    from spotlight_runtime.imaging.colour import linear_to_srgb

    job = client.wait(client.relight(scene, [LIGHT], model="tiny"))
    (tmp_path / "linear.exr").write_bytes(client.result(job, "x-exr"))
    (tmp_path / "encoded.png").write_bytes(client.result(job))
    linear, encoded = read_image(tmp_path / "linear.exr"), read_image(tmp_path / "encoded.png")
    half = 2.0**-11  # the file's numbers, in sRGB
    assert np.abs(linear_to_srgb(linear) - encoded).max() <= 0.5 / 255 + half


def test_drawn_shadows_and_several_lights(client, scene, drawing):
    lights = [drawn(drawing, weight=2.0, colour=[1.0, 0.8, 0.6]), LIGHT]
    job = client.wait(client.relight(scene, lights, model="tiny"))
    assert job.state == "done", job.facts["error"]
    assert client.report(job)["lights"] == 2
    assert len(job.facts["request"]["lights"][0]["shadow"]) == 64  # a digest, not the picture


def test_a_sweep_is_a_contact_sheet(client, scene):
    lights = [{"azimuth": a, "elevation": 45} for a in (0, 90, 180)]
    job = client.wait(client.relight(scene, lights, model="tiny", sweep=True))
    assert job.state == "done", job.facts["error"]
    sheet = decoded(client.result(job))
    assert sheet.shape[1] > 3 * 96
    assert len(client.report(job)["pictures"]) == 3


def test_each_picture_of_a_sweep_is_what_its_light_makes(client, scene):
    lights = [{"azimuth": a, "elevation": 45} for a in (0, 90)]
    job = client.wait(client.relight(scene, lights, model="tiny", sweep=True))
    alone = client.wait(client.relight(scene, lights[1:], model="tiny"))
    assert client.result(job, light=1) == client.result(alone)
    assert client.result(job, "x-exr", light=1) == client.result(alone, "x-exr")
    for asked, light, expected in ((job, 2, "0 to 1"), (alone, 0, "none")):
        with pytest.raises(ServiceError) as told:
            client.result(asked, light=light)
        assert told.value.status == 404
        assert told.value.problem["errors"][0]["expected"] == expected


def test_sketches_follow_the_light(client, scene, drawing):
    right = decoded(client.sketch(scene, [{"azimuth": 0, "elevation": 30}], "shadow"))
    left = decoded(client.sketch(scene, [{"azimuth": 180, "elevation": 30}], "shadow"))
    assert right[:, :40].sum() > 2 * right[:, 56:].sum()  # a light at the right: shadow at the left
    assert left[:, 56:].sum() > 2 * left[:, :40].sum()
    shown = decoded(client.sketch(scene, [drawn(drawing)]))
    assert shown.shape == (64, 96, 3)


@pytest.mark.parametrize("show", ["draft", "background", "mask"])
def test_scenes_can_be_seen(server, scene, show):
    answer = httpx.get(f"{server.address}/v1/scenes/{scene.id}/picture", params={"show": show})
    assert answer.headers["content-type"] == "image/png"
    assert decoded(answer.content).shape[:2] == (64, 96)


def test_an_idempotency_key_makes_one_job_of_two_requests(client, scene):
    first = client.relight(scene, [LIGHT], model="tiny", idempotency_key="order-7")
    again = client.relight(scene, [LIGHT], model="tiny", idempotency_key="order-7")
    assert again.id == first.id
    with pytest.raises(ServiceError) as caught:
        client.relight(scene, [LIGHT], model="tiny", seed=5, idempotency_key="order-7")
    assert caught.value.status == 422
    assert caught.value.problem["errors"][0]["field"] == "Idempotency-Key"


WRONG = {
    "lights[0].elevation": {"lights": [{"azimuth": 1, "elevation": 91}]},
    "lights[0].azimuth": {"lights": [{"azimuth": "left", "elevation": 1}]},
    "lights[0].light": {"lights": [{"azimuth": 1}]},
    "lights[0].radius of a directional light": {
        "lights": [{"azimuth": 1, "elevation": 1, "distance": None, "radius": 70}]
    },
    "lights": {"lights": []},
    "gamma": {"gamma": 21},
    "steps": {"steps": 0},
    "solver": {"solver": "magic"},
    "plain_steps": {"plain_steps": 0},
    "guidance_interval[1]": {"guidance_interval": [0, 1.5]},
    "reuse": {"reuse": 0},
    "model": {"model": "colossal"},
    "plan": {"plan": "best"},
    "budget_s": {"budget_s": 5, "plan": "exact"},
    "deadline_s": {"deadline_s": 1e9},
    "surprise": {"surprise": 1},
    "scene": {"scene": "nonsense"},
}


@pytest.mark.parametrize("field", WRONG)
def test_problems_name_field_expected_and_got(server, scene, field):
    body = {"scene": scene.id, "lights": [LIGHT], "model": "tiny", **WRONG[field]}
    answer = httpx.post(f"{server.address}/v1/relight", json=body)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    named = problem["errors"][0]
    assert named["field"] == field, problem
    assert named["expected"]
    assert named["got"]
    assert problem["request"] == answer.headers["x-request-id"]


def test_what_is_not_there_is_404_in_the_same_form(server):
    for path in ("/v1/jobs/" + "0" * 32, "/v1/scenes/" + "0" * 64, "/v1/nothing", "/v2/models/x"):
        answer = httpx.get(server.address + path)
        assert answer.status_code == 404, path
        assert answer.headers["content-type"] == "application/problem+json", path


def test_a_body_that_is_no_json(server):
    headers = {"Content-Type": "application/json"}
    answer = httpx.post(f"{server.address}/v1/relight", content=b'{"scene": ', headers=headers)
    assert answer.status_code == 400
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_result_is_409_until_it_is_there(server, client, scene):
    job = client.relight(scene, [LIGHT] * 4, model="tiny", steps=1000)
    with pytest.raises(ServiceError) as caught:
        client.result(job)
    assert caught.value.status == 409
    client.cancel(job)


def test_plans_take_fewer_evaluations_and_options_of_ones_own_go_before(client, scene):
    def evaluations(**wishes):
        job = client.wait(client.relight(scene, [LIGHT], model="tiny", **wishes))
        assert job.state == "done", job.facts["error"]
        report = client.report(job)
        assert job.facts["plan"]["evaluations"] == report["evaluations"]
        return report["evaluations"], report["options"]["steps"]

    # The tiny backbone's own 4 steps are fewer than a balanced plan's.
    assert evaluations(plan="draft", seed=21) < evaluations(plan="exact", seed=22)
    assert evaluations(plan="draft", steps=3, seed=23)[1] == 3
    own = {"steps": 4, "plain_steps": 1, "guidance_interval": [0.5, 1.0]}
    assert evaluations(plan="exact", seed=24, **own) == (4 + 2 + 1, 4)


def test_a_budget_is_kept_or_refused(client, scene):
    job = client.wait(client.relight(scene, [LIGHT], model="tiny", budget_s=600))
    assert job.facts["plan"]["name"] == "exact"
    tight = client.wait(client.relight(scene, [LIGHT], model="tiny", budget_s=1e-6))
    assert tight.state == "failed"
    assert tight.facts["error"]["status"] == 422
    assert "budget" in tight.facts["error"]["detail"]


def test_jobs_are_listed_newest_first(client, scene):
    made = [client.relight(scene, [LIGHT], model="tiny", seed=s).id for s in (1, 2)]
    listed = [job.id for job in client.jobs(limit=2)]
    assert listed == made[::-1]
    for job in made:
        client.wait(job)


def test_what_a_job_fails_of_is_told_without_paths(client, scene, server):
    job = client.wait(client.relight(scene, [LIGHT], model="broken"))
    assert job.state == "failed"
    told = job.facts["error"]
    assert told["status"] == 500
    assert "finite" in told["detail"]
    assert str(server.data) not in json.dumps(job.facts)


def test_plans_say_each_thing_they_leave_out(client):
    said = {plan["name"]: plan["summary"] for plan in client.capabilities()["plans"]["mini"]}
    words = {
        "steps": "steps of",
        "plain_steps": "without shadow",
        "guidance_interval": "guidance from",
        "reuse": "whole network in one of",
        "window": "about object and shadow",
    }
    for name, summary in said.items():
        options = set(named_rung(name).options) - {"solver"}
        assert options <= set(words), "a plan says something that is not told"
        assert {option for option, phrase in words.items() if phrase in summary} == options
