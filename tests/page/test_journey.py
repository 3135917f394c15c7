"""From a photograph that is dropped to the picture that is taken away."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from service.hostile import cutout, picture

from spotlight_runtime import read_image

from .conftest import drop, relit, sketched, take_sample

CENTRE = """selector => {
    const box = document.querySelector(selector).getBoundingClientRect();
    return [box.x + box.width / 2, box.y + box.height / 2];
}"""


def value(page, label):
    return float(page.get_by_label(label, exact=True).input_value())


def test_drop_place_drag_relight_compare_download_reload(visit, client, tmp_path):
    (tmp_path / "room.jpg").write_bytes(picture(".jpg", (96, 128)))
    (tmp_path / "vase.png").write_bytes(cutout())
    page = visit()
    page.locator(".sample img[src^='blob:']").nth(2).wait_for()  # the last scene not of our making

    # Drop a photograph, then its object; it is put in where the floor was clicked before.
    drop(page, tmp_path / "room.jpg")
    page.get_by_role("heading", name="Now the object").wait_for()
    spot = page.locator("#spot").bounding_box()
    page.locator("#spot").click(position={"x": spot["width"] * 0.4, "y": spot["height"] * 0.5})
    drop(page, tmp_path / "vase.png")
    page.locator("#stage-bar").wait_for()
    assert "vase.png in room.jpg" in page.locator("#where").inner_text()

    # Place it: a click moves it, and the service has a scene with it there.
    page.locator("#views").get_by_role("radio", name="Place").check()
    spot = page.locator("#spot").bounding_box()
    with page.expect_response(lambda answer: answer.url.endswith("/v1/scenes")) as composed:
        page.locator("#spot").click(position={"x": spot["width"] * 0.6, "y": spot["height"] * 0.9})
    left, _, right, bottom = composed.value.json()["object_box"]
    assert left < 0.6 < right
    assert bottom == pytest.approx(0.9, abs=0.06)

    # Drag the light: sketches follow while it is held, and the numbers say where it is.
    page.locator("#views").get_by_role("radio", name="Light").check()
    page.locator("#sketch").wait_for()
    before = value(page, "Azimuth"), value(page, "Elevation")
    x, y = page.evaluate(CENTRE, ".lamp")
    page.mouse.move(x, y)
    page.mouse.down()
    sketched(page, lambda: page.mouse.move(x + 25, y + 30, steps=6))
    sketched(page, page.mouse.up)
    after = value(page, "Azimuth"), value(page, "Elevation")
    assert abs(after[0] - before[0]) > 3 or abs(after[1] - before[1]) > 3
    told = page.get_by_role("slider", name="Light", exact=True).get_attribute("aria-valuetext")
    assert f"azimuth {after[0]:.0f}°, elevation {after[1]:.0f}°" in told

    # Relight: seconds are told beforehand, and the picture can be compared.
    page.get_by_text("Draft", exact=True).click()
    page.locator("#relight-seconds", has_text="about").wait_for()
    page.get_by_role("button", name="Relight").click()
    page.locator("#compare").wait_for()
    divider = page.get_by_label("Share of the picture that shows before")
    divider.focus()
    clip = page.locator("#after").evaluate("image => image.style.clipPath")
    page.keyboard.press("PageUp")
    assert page.locator("#after").evaluate("image => image.style.clipPath") != clip

    # Take it away: the very picture and report that the service has.
    job = client.jobs()[0].facts
    with page.expect_download() as picture_file:
        page.get_by_role("button", name="Download picture").click()
    assert picture_file.value.path().read_bytes() == client.result(job["id"])
    with page.expect_download() as report_file:
        page.get_by_role("button", name="Report").click()
    assert json.loads(report_file.value.path().read_text())["plan"]["name"] == "draft"
    asked = job["request"]["lights"][0]
    assert (round(asked["azimuth"]), round(asked["elevation"])) == (
        round(after[0]),
        round(after[1]),
    )

    # Reload: the picture, its light and its files are still here.
    page.reload()
    page.locator("#compare").wait_for()
    assert page.locator("#history li").count() == len(client.jobs())
    assert value(page, "Azimuth") == pytest.approx(after[0], abs=0.51)
    assert page.get_by_role("button", name="Replace the photo").is_visible()
    assert page.locator("#history [aria-current=true]").count() == 1


def test_scribble(visit, client, tmp_path):
    page = visit()
    take_sample(page, "Bench")
    page.get_by_role("radio", name="Paint its shadow").check()
    box = page.locator("#brush").bounding_box()

    def at(x, y):
        return box["x"] + box["width"] * x, box["y"] + box["height"] * y

    def stroke(start, end):
        page.mouse.move(*at(*start))
        page.mouse.down()
        page.mouse.move(*at(*end), steps=8)
        page.mouse.up()

    plain = shown(page, tmp_path, "#base")
    sketched(page, lambda: stroke((0.3, 0.8), (0.7, 0.8)))
    rows, columns = slice(196, 212), slice(90, 170)  # of the 256 that the sample has
    assert (
        shown(page, tmp_path, "#sketch")[rows, columns] < 0.8 * plain[rows, columns]
    ).mean() > 0.9

    page.get_by_role("radio", name="Eraser").check()
    sketched(page, lambda: stroke((0.6, 0.8), (0.75, 0.8)))
    assert (
        np.abs(shown(page, tmp_path, "#sketch")[rows, 160:176] - plain[rows, 160:176]).max() < 0.03
    )
    sketched(page, lambda: page.get_by_role("button", name="Undo").click())
    assert (
        shown(page, tmp_path, "#sketch")[rows, columns] < 0.8 * plain[rows, columns]
    ).mean() > 0.9

    # By the keyboard, too.
    page.locator("#brush").focus()
    sketched(page, lambda: page.keyboard.press("Space"))

    relit(page)
    assert "shadow" in client.jobs()[0].facts["request"]["lights"][0]
    assert "Painted shadow" in page.locator("#history li").first.inner_text()

    # Reload: the picture is here, and what was painted for it.
    page.reload()
    page.locator("#compare").wait_for()
    assert page.get_by_role("radio", name="Paint its shadow").is_checked()
    page.locator("#views").get_by_role("radio", name="Light").check()
    page.locator("#sketch").wait_for()  # at first with the light a scene begins with
    for _ in range(100):
        again = shown(page, tmp_path, "#sketch")[rows, columns]
        if (again < 0.8 * plain[rows, columns]).mean() > 0.9:
            break
        page.wait_for_timeout(300)
    else:
        pytest.fail("what was painted is not sketched again")


def shown(page, folder, selector):
    """What an <img> shows, sRGB, at the picture's own size."""
    url = page.evaluate(
        """async selector => {
            const image = document.querySelector(selector);
            for (let left = 50; ; left -= 1) {
                try {
                    await image.decode();
                    break;
                } catch (error) {  // another picture was put in its place meanwhile
                    if (!left) throw error;
                    await new Promise((resolve) => setTimeout(resolve, 100));
                }
            }
            const canvas = document.createElement("canvas");
            [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
            canvas.getContext("2d").drawImage(image, 0, 0);
            return canvas.toDataURL();
        }""",
        selector,
    )
    (folder / "shown.png").write_bytes(base64.b64decode(url.partition(",")[2]))
    return read_image(folder / "shown.png")[..., :3]


def lengthened(route):
    """Ask for more steps than anybody waits for, so that there is something left to cancel."""
    asked = json.loads(route.request.post_data)
    del asked["plan"]
    route.continue_(post_data=json.dumps({**asked, "steps": 1000}))


def test_cancel(visit, client):
    page = visit()
    page.route("**/v1/relight", lengthened)
    take_sample(page)
    page.get_by_role("button", name="Relight").click()
    page.locator("#forming").wait_for()
    page.get_by_role("button", name="Cancel", exact=True).click()
    page.locator("#run").wait_for(state="hidden")
    page.locator("#history li").first.get_by_text("Cancelled").wait_for()
    assert client.jobs()[0].facts["state"] == "cancelled"
    assert page.get_by_role("button", name="Relight").is_enabled()


def test_an_answer_that_its_event_overtook_changes_nothing(visit):
    page = visit()
    page.route("**/v1/relight", lengthened)
    held = []

    def late(route):
        if route.request.method == "DELETE":
            held.append((route, route.fetch()))  # "running, being cancelled", as it was then
        else:
            route.continue_()

    page.route("**/v1/jobs/*", late)
    take_sample(page)
    page.get_by_role("button", name="Relight").click()
    page.locator("#forming").wait_for()
    page.get_by_role("button", name="Cancel", exact=True).click()
    page.locator("#run").wait_for(state="hidden")  # the event has come
    [(route, answer)] = held
    assert answer.json()["state"] == "running"
    with page.expect_response(lambda other: other.request.method == "DELETE"):
        route.fulfill(response=answer)
    page.evaluate("new Promise((resolve) => setTimeout(resolve, 100))")
    assert "Cancelled" in page.locator("#history li").first.inner_text()


def test_several_lights_of_a_scene(visit, client):
    page = visit()
    take_sample(page, "Berries")
    sketched(page, lambda: page.get_by_role("button", name="Add a light").click())
    assert page.locator(".lamp:visible").count() == 2
    sketched(page, lambda: page.get_by_label("Colour", exact=True).fill("#ff8000"))
    sketched(
        page, lambda: page.get_by_label("Weight, number").fill("0.5") or page.keyboard.press("Tab")
    )
    relit(page)
    first, second = client.jobs()[0].facts["request"]["lights"]
    assert first["colour"] == [1.0, 1.0, 1.0]
    assert second["weight"] == 0.5
    assert second["colour"] == pytest.approx([1.0, 0.2159, 0.0], abs=1e-3)
    assert second["azimuth"] == (first["azimuth"] + 120) % 360
    page.get_by_role("button", name="Remove this light").click()
    assert page.locator(".lamp:visible").count() == 1


def test_refusals_are_told_as_the_service_put_them(visit, tmp_path):
    (tmp_path / "notes.txt").write_text("no picture")
    (tmp_path / "vase.png").write_bytes(cutout())
    page = visit(expected=["Failed to load resource"])
    drop(page, tmp_path / "notes.txt", tmp_path / "vase.png")
    page.locator(".toast").wait_for()
    assert "photo" in page.locator(".toast").first.inner_text()
    assert page.get_by_role("button", name="Replace the photo").is_enabled()


def test_what_is_painted_survives_a_reload_before_there_is_a_picture(visit):
    page = visit()
    take_sample(page, "Bench")
    sketched(page, lambda: page.get_by_role("button", name="Add a light").click())
    page.get_by_role("radio", name="Paint its shadow").check()
    page.locator("#brush").focus()
    sketched(page, lambda: page.keyboard.press("Space"))
    inked = "canvas => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data"
    total = f"canvas => ({inked})(canvas).reduce((sum, value) => sum + value, 0)"
    before = page.locator("#brush").evaluate(total)
    assert before > 0
    page.reload()
    page.locator("#sketch").wait_for()
    page.get_by_role("button", name="Light 2").click()
    assert page.locator("#brush").evaluate(total) == before


def test_a_light_as_far_away_as_the_sun(visit):
    page = visit()
    take_sample(page)
    distance = page.locator("#placed-rows").get_by_label("Distance", exact=True)
    assert distance.is_visible()
    with page.expect_request(lambda request: request.url.endswith("/shadow")) as asked:
        page.get_by_role("radio", name="Sun").check()
    (light,) = asked.value.post_data_json["lights"]
    assert (light["distance"], light["radius"]) == (None, 0.27)
    assert distance.is_hidden()
    softness = page.locator("#placed-rows").get_by_label("Softness, °")
    with page.expect_request(lambda request: request.url.endswith("/shadow")) as asked:
        softness.fill("5")
        page.keyboard.press("Tab")
    assert asked.value.post_data_json["lights"][0]["radius"] == 5
    page.reload()
    page.locator("#sketch").wait_for()
    assert page.get_by_role("radio", name="Sun").is_checked()
    assert float(softness.input_value()) == 5
    with page.expect_request(lambda request: request.url.endswith("/shadow")) as asked:
        page.get_by_role("radio", name="Lamp").check()
    (light,) = asked.value.post_data_json["lights"]
    assert (light["distance"], light["radius"]) == (10, 1)


def test_a_sweep_is_leafed_through(visit, client):
    lights = [{"azimuth": azimuth, "elevation": 45} for azimuth in (0, 90)]
    scene = client.sample("goblet")
    job = client.wait(client.relight(scene, lights, sweep=True, steps=2))
    page = visit()
    page.get_by_role("button", name="2 directions").first.click()
    direction = page.get_by_role("slider", name="Direction")
    direction.wait_for()
    assert page.locator("#compare").is_hidden()
    assert direction.get_attribute("aria-valuetext") == "All on a sheet"

    direction.focus()
    page.keyboard.press("End")
    page.locator("#compare").wait_for()
    assert direction.get_attribute("aria-valuetext") == "90°, behind"
    assert value(page, "Azimuth") == 90  # where a relight would go on
    assert page.locator(".lamp").count() == 1
    divider = page.get_by_label("Share of the picture that shows before")
    divider.fill("20")
    direction.focus()
    page.keyboard.press("ArrowLeft")
    page.get_by_text("0°, right", exact=True).wait_for()
    assert divider.input_value() == "20"
    page.wait_for_function("() => document.querySelector('#after').naturalWidth === 256")
    with page.expect_download() as picture_file:
        page.get_by_role("button", name="Download picture").click()
    assert picture_file.value.path().read_bytes() == client.result(job, light=0)
    direction.focus()
    page.keyboard.press("Home")
    page.locator("#compare").wait_for(state="hidden")


@pytest.mark.full
def test_eight_directions(visit, client):
    page = visit()
    take_sample(page)
    page.get_by_text("Draft", exact=True).click()
    page.get_by_role("button", name="Eight directions").click()
    page.locator("#takeaway").wait_for()
    assert page.locator("#compare").is_hidden()
    lights = client.jobs()[0].facts["request"]["lights"]
    assert [light["azimuth"] for light in lights] == [i * 45.0 for i in range(8)]
    assert "8 directions" in page.locator("#history li").first.inner_text()
    assert page.get_by_role("slider", name="Direction").get_attribute("max") == "8"


def test_the_forming_picture_lies_where_it_is_diffused(visit, client, tmp_path):
    """Of a large photograph a window is diffused: the preview says which, and is shown there."""
    (tmp_path / "room.jpg").write_bytes(picture(".jpg", (600, 800)))
    (tmp_path / "vase.png").write_bytes(cutout())
    place = {"at": (0.3, 0.9), "height": 0.2, "horizon": 0.2}
    scene = client.compose(tmp_path / "room.jpg", tmp_path / "vase.png", **place)
    job = client.relight(scene, [{"azimuth": 135, "elevation": 45}], plan="exact")
    previews = (event for event in client.events(job) if event.kind == "preview")
    left, top, right, bottom = next(previews).data["window"]
    box = scene.facts["object_box"]
    assert 0 <= left < box[0] < box[2] < right <= 1
    assert 0 <= top < box[1] < box[3] < bottom <= 1
    assert right - left < 0.9

    # Whoever opens the page now sees it form there, and comes closer.
    page = visit()
    page.locator("#forming").wait_for()
    picture_box = page.locator("#picture").bounding_box()
    forming = page.locator("#forming").bounding_box()
    share = (forming["x"] - picture_box["x"]) / picture_box["width"]
    assert share == pytest.approx(left, abs=0.01)
    page.get_by_role("button", name="Closer").click()
    assert page.locator("#picture").bounding_box()["width"] > 1.5 * picture_box["width"]
    client.cancel(job)
    page.locator("#run").wait_for(state="hidden")
