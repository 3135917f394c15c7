"""What is wrong with a request is told of its very field, in words."""

from __future__ import annotations

import json

import httpx
import pytest

LIGHT = {"azimuth": 200.0, "elevation": 40.0}
FORM = "application/x-www-form-urlencoded"
TEXT = {"Content-Type": "text/plain"}
A_LIGHT = "a JSON object, of a placed light or with a shadow"
NEGATIVE = "'opposite', 'none' or a placed light"


def told(answer: httpx.Response, status: int) -> tuple[str, str, str]:
    """The one thing that is wrong: field, expected, got."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    ((field, expected, got),) = ((e["field"], e["expected"], e["got"]) for e in problem["errors"])
    assert problem["detail"].startswith(f"{field}: expected {expected}, got {got}")
    return field, expected, got


@pytest.mark.parametrize(
    ("changes", "field", "expected", "got"),
    [
        (
            {"lights": [{"azimuth": 1, "elevation": 120}]},
            *("lights[0].elevation", "a number of at most 90", "120"),
        ),
        ({"lights": [LIGHT, {"azimuth": "left"}]}, "lights[1].azimuth", "a number", "'left'"),
        ({"lights": [{**LIGHT, "far": 1}]}, "lights[0].far", "no field of this name", "1"),
        (
            {"lights": [{"shadow": ""}]},
            *("lights[0].shadow", "text of at least 1 characters", "''"),
        ),
        ({"lights": [{"shadow": "A", "invert": 7}]}, "lights[0].invert", "true or false", "7"),
        ({"lights": [5]}, "lights[0]", A_LIGHT, "5"),
        ({"lights": []}, "lights", "a list of at least 1", "[]"),
        ({"lights": LIGHT}, "lights", "a list", repr(LIGHT)),
        ({"negative": "no"}, "negative", "'opposite' or 'none'", "'no'"),
        ({"negative": 5}, "negative", NEGATIVE, "5"),
        (
            {"negative": {"azimuth": 1, "distance": 0}},
            *("negative.distance", "a number above 0", "0"),
        ),
        ({"scene": "nonsense"}, "scene", "64 hexadecimal digits", "'nonsense'"),
        ({"steps": 1.5}, "steps", "a whole number", "1.5"),
        ({"plan": "best"}, "plan", "'exact', 'balanced' or 'draft'", "'best'"),
        ({"foo": 1}, "foo", "no field of this name", "1"),
    ],
)
def test_wrong_values(server, changes, field, expected, got):
    body = {"scene": "0" * 64, "lights": [LIGHT], **changes}
    answer = httpx.post(f"{server.address}/v1/relight", json=body)
    assert told(answer, 422) == (field, expected, got)


def test_what_is_left_out(server):
    answer = httpx.post(f"{server.address}/v1/relight", json={"lights": [LIGHT]})
    assert told(answer, 422) == ("scene", "a value", "nothing")


def test_a_body_that_is_no_json(server):
    headers = {"Content-Type": "application/json"}
    answer = httpx.post(f"{server.address}/v1/relight", content=b"{bad", headers=headers)
    field, expected, got = told(answer, 400)
    assert (field, expected) == ("body", "JSON")
    assert got.endswith("character 1)")


@pytest.mark.parametrize(
    ("path", "sent", "got"),
    [
        ("/v1/relight", {"content": b"{}", "headers": TEXT}, "text/plain"),
        ("/v1/relight", {"content": b"{}"}, "nothing"),
        ("/v1/relight", {"data": {"scene": "0"}}, FORM),
        (f"/v1/scenes/{'0' * 64}/shadow", {"data": {"side": 64}}, FORM),
        ("/v1/scenes", {"json": {"sample": "goblet"}}, "application/json"),
    ],
)
def test_bodies_of_another_type(server, path, sent, got):
    answer = httpx.post(server.address + path, **sent)
    forms = f"multipart/form-data or {FORM}"
    expected = forms if path == "/v1/scenes" else "application/json"
    assert told(answer, 415) == ("Content-Type", expected, got)


def test_json_that_turns_out_too_large(server):
    def pieces():
        yield b'{"scene": "'
        for _ in range(17):
            yield b"0" * 1_000_000

    headers = {"Content-Type": "application/json"}
    answer = httpx.post(f"{server.address}/v1/relight", content=pieces(), headers=headers)
    field, expected, got = told(answer, 413)
    assert (field, expected) == ("body", f"at most {16 << 20} bytes")
    assert got.endswith(" or more")


NOT_BESIDE = "nothing where no object is put into a photo"


@pytest.mark.parametrize(
    ("form", "expected"),
    [
        ({"foo": "1", "sample": "goblet"}, "no field of this name"),
        ({"yaw": "90", "sample": "goblet"}, NOT_BESIDE),
        ({"at": "0.1,0.2", "sample": "goblet"}, NOT_BESIDE),
        ({"at": "abc"}, "two numbers with a comma between"),
        ({"at": "nan,1"}, "fractions of the picture from 0 to 1"),
    ],
)
def test_fields_of_a_form_that_would_count_for_nothing(server, form, expected):
    (field, got) = next(iter(form.items()))
    answer = httpx.post(f"{server.address}/v1/scenes", data=form)
    assert told(answer, 422) == (field, expected, got)


def test_a_text_for_a_file(server):
    answer = httpx.post(f"{server.address}/v1/scenes", data={"photo": "room.jpg"})
    assert told(answer, 422) == ("photo", "a file", "'room.jpg'")


def test_nothing_is_placed_in_a_bundle(server, bundle):
    with bundle.open("rb") as file:
        sent = {"files": {"bundle": file}, "data": {"size": "2"}}
        answer = httpx.post(f"{server.address}/v1/scenes", **sent)
    assert told(answer, 422) == ("size", NOT_BESIDE, "2")


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("GET", "/v1/relight", "POST"),
        ("GET", "/v1/scenes", "POST"),
        ("DELETE", "/v1/jobs", "GET"),
        ("POST", "/v1/capabilities", "GET"),
    ],
)
def test_methods_there_are_not(server, method, path, allowed):
    answer = httpx.request(method, server.address + path)
    assert answer.status_code == 405
    assert answer.headers["Allow"] == allowed
    assert answer.headers["content-type"] == "application/problem+json"
    assert json.loads(answer.text)["status"] == 405
