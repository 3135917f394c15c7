"""What goes wrong, or is thought better of, halfway."""

from __future__ import annotations

import json

import pytest
from service.hostile import cutout, picture

from .conftest import drop, take_sample
from .test_journey import lengthened

BOX = "".join(
    [
        *(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)),
        *("f 1 2 4 3\n", "f 5 7 8 6\n", "f 1 5 6 2\n", "f 3 4 8 7\n", "f 1 3 7 5\n", "f 2 6 8 4\n"),
    ]
)


def is_scene(event):
    return event.url.endswith("/v1/scenes")


@pytest.fixture
def files(tmp_path):
    (tmp_path / "room.jpg").write_bytes(picture(".jpg", (96, 128)))
    (tmp_path / "vase.png").write_bytes(cutout())
    (tmp_path / "box.obj").write_text(BOX)
    (tmp_path / "broken.zip").write_bytes(b"PK\x03\x04 and so on")
    return tmp_path


def hold(page, pattern):
    """Requests that get nowhere, as they come."""
    held = []

    def keep(route):
        held.append(route)

    page.route(pattern, keep)
    return held


def composed(page, *paths):
    """Put one into the other, once the page makes no scenes of its own any more."""
    page.locator(".sample img[src^='blob:']").nth(2).wait_for()
    drop(page, *paths)
    page.locator("#stage-bar").wait_for()
    page.locator("#views").get_by_role("radio", name="Place").check()


def test_starting_over_drops_the_scene_that_is_on_its_way(visit, files):
    page = visit(expected=["ERR_"])
    page.locator(".sample img[src^='blob:']").nth(2).wait_for()
    hold(page, "**/v1/scenes")
    drop(page, files / "room.jpg", files / "vase.png")
    page.get_by_text("Putting it in…").wait_for()
    with page.expect_event("requestfailed", is_scene):
        page.get_by_role("button", name="New scene").click()
    page.locator("#busy").wait_for(state="hidden")
    assert page.locator("#desk").get_attribute("data-scene") == "none"
    assert page.locator(".toast").count() == 0


def test_a_broken_bundle_leaves_what_stands_here(visit, files):
    page = visit(expected=["Failed to load resource"])
    composed(page, files / "room.jpg", files / "vase.png")
    drop(page, files / "broken.zip")
    page.locator(".toast").wait_for()
    assert page.get_by_role("button", name="Replace the object").is_visible()
    spot = page.locator("#spot").bounding_box()
    with page.expect_response(is_scene) as answered:
        page.locator("#spot").click(position={"x": spot["width"] * 0.4, "y": spot["height"] * 0.9})
    assert answered.value.ok


def test_a_cutout_is_not_turned(visit, files):
    page = visit()
    composed(page, files / "room.jpg", files / "box.obj")
    turn = page.get_by_label("Turn, °")
    with page.expect_response(is_scene):
        turn.fill("30")
        page.keyboard.press("Tab")
    with page.expect_response(is_scene) as answered:
        drop(page, files / "vase.png")
    assert answered.value.ok
    assert turn.is_hidden()


def test_cancelled_before_there_is_a_job(visit, client):
    page = visit()
    held = hold(page, "**/v1/relight")
    take_sample(page)
    with page.expect_request("**/v1/relight"):
        page.get_by_role("button", name="Relight").click()
    page.get_by_role("button", name="Cancel", exact=True).click()
    page.get_by_text("Cancelling…").wait_for()
    with page.expect_response(lambda answer: answer.request.method == "DELETE"):
        lengthened(held[0])
    page.locator("#run").wait_for(state="hidden")
    assert client.jobs()[0].facts["state"] == "cancelled"


def test_a_cancel_that_does_not_arrive_can_be_sent_again(visit, client):
    page = visit(expected=["ERR_FAILED"])
    page.route("**/v1/relight", lengthened)
    lost = []

    def lose(route):
        if route.request.method == "DELETE" and not lost:
            lost.append(route)
            route.abort()
        else:
            route.continue_()

    page.route("**/v1/jobs/*", lose)
    take_sample(page)
    with page.expect_response("**/v1/relight"):
        page.get_by_role("button", name="Relight").click()
    cancel = page.get_by_role("button", name="Cancel", exact=True)
    cancel.click()
    page.get_by_text("cannot be reached").wait_for()
    page.locator("#run-text", has_not_text="Cancelling…").wait_for()  # it goes on, and says so
    assert cancel.is_enabled()
    cancel.click()
    page.locator("#run").wait_for(state="hidden")
    assert client.jobs()[0].facts["state"] == "cancelled"


@pytest.fixture
def locked(visit):
    """The page of a service that wants a key."""

    def answer(route):
        if route.request.headers.get("authorization") == "Bearer right":
            route.continue_()
        else:
            body = json.dumps({"detail": "Authorization: expected Bearer and an API key"})
            route.fulfill(status=401, content_type="application/problem+json", body=body)

    page = visit(expected=["401"])
    page.route("**/v1/**", answer)
    page.reload()
    return page


def test_a_wrong_key_is_called_wrong(locked):
    refusal = locked.get_by_role("alert").filter(has_text="That key is not valid here")
    for key, refused in (("wrong", False), ("right", True)):
        locked.get_by_label("API key").wait_for()
        assert refusal.count() == refused
        locked.get_by_label("API key").fill(key)
        locked.get_by_role("button", name="Use it").click()
        if key == "wrong":
            refusal.wait_for()
    take_sample(locked)
    assert locked.get_by_role("button", name="Enter a key").is_hidden()


def test_who_has_no_key_is_asked_once(locked):
    locked.get_by_label("API key").wait_for()
    locked.keyboard.press("Escape")
    locked.get_by_role("button", name="Enter a key").wait_for()
    locked.wait_for_timeout(3000)  # in which the page would have looked at the service again
    assert locked.get_by_label("API key").is_hidden()
    locked.get_by_role("button", name="Enter a key").click()
    locked.get_by_label("API key").wait_for()


def test_history_says_why_a_job_failed(visit, client):
    scene = client.sample("goblet")
    light = {"azimuth": 135, "elevation": 45}
    job = client.wait(client.relight(scene, [light], deadline_s=0.001))
    why = job.facts["error"]["detail"]
    page = visit()
    page.locator("#history li").first.get_by_text(why).wait_for()
