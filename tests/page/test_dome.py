"""The dome's geometry, as the runtime has it, and what is dragged over it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from .conftest import sketched, take_sample

ROUND_TRIP = """async ([scene, lights]) => {
    const { Dome } = await import("/dome.js");
    const root = document.createElement("div");
    const dome = new Dome(root, () => {}, () => {});
    dome.stand(scene);
    return lights.map(({ azimuth, elevation }) => {
        const at = dome.place(azimuth, elevation);
        const grip = { front: dome.inFront({ azimuth, elevation }), outside: false };
        return [at, dome.under(at, grip)];
    });
}"""
PROJECTED = """async ([width, height, fov, points]) => {
    const { Camera } = await import("/geometry.js");
    const camera = new Camera(width, height, fov);
    return points.map((point) => camera.project(point));
}"""


@pytest.fixture(scope="module")
def bare(browser, server):
    """A page of the service's, for calling its modules."""
    page = browser.new_page()
    page.goto(server.address + "/icon.svg")
    yield page
    page.close()


@settings(max_examples=20, deadline=None)
@given(
    pitch=st.floats(3, 70),
    roll=st.floats(-8, 8),
    fov=st.floats(25, 90),
    left=st.floats(0.1, 0.6),
    lights=st.lists(st.tuples(st.floats(0, 359.9), st.floats(4, 88)), min_size=1, max_size=8),
)
def test_a_lamp_that_is_let_go_where_it_was_stays(bare, pitch, roll, fov, left, lights):
    p, r = np.radians([pitch, roll])
    normal = [np.sin(r), np.cos(r) * np.cos(p), np.cos(r) * np.sin(p)]
    box = [left, 0.3, left + 0.3, 0.8]
    scene = {"width": 320, "height": 240, "field_of_view": fov, "floor_normal": normal}
    placed = [{"azimuth": a, "elevation": e} for a, e in lights]
    found = bare.evaluate(ROUND_TRIP, [{**scene, "object_box": box}, placed])
    for (azimuth, elevation), (_, got) in zip(lights, found):
        turned = (got["azimuth"] - azimuth + 180) % 360 - 180
        # Near the outline a pixel is many degrees, and the arithmetic may say "past it".
        assert abs(turned) * np.cos(np.radians(elevation)) < 0.5
        assert got["elevation"] == pytest.approx(elevation, abs=0.5)


def test_the_camera_is_the_runtimes(bare):
    from spotlight_runtime.geometry.camera import Camera

    camera = Camera(field_of_view=50.0, height=120, width=160)
    points = np.random.default_rng(0).uniform([-1, -1, -4], [1, 1, -2], (16, 3))
    got = np.array(bare.evaluate(PROJECTED, [160, 120, 50.0, points.tolist()]))
    want = camera.project(points)[:, :2] / [160, 120]
    np.testing.assert_allclose(got, want, atol=1e-6)


def test_arrow_keys_move_the_lamp(visit):
    page = visit()
    take_sample(page)
    lamp = page.get_by_role("slider", name="Light", exact=True)
    lamp.focus()
    start = int(lamp.get_attribute("aria-valuenow"))
    sketched(page, lambda: page.keyboard.press("ArrowRight"))
    assert int(lamp.get_attribute("aria-valuenow")) == start + 2
    sketched(page, lambda: page.keyboard.press("Shift+ArrowLeft"))
    assert int(lamp.get_attribute("aria-valuenow")) == start + 2 - 15
    sketched(page, lambda: page.keyboard.press("PageUp"))
    assert "elevation 60°" in lamp.get_attribute("aria-valuetext")


def test_over_the_edge_it_goes_round(visit):
    page = visit()
    take_sample(page, "Berries")
    lamp = page.get_by_role("slider", name="Light", exact=True)
    assert "behind" in lamp.get_attribute("aria-valuetext")
    box, dome = lamp.bounding_box(), page.locator("#dome").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 30, y - 120, steps=6)
    page.mouse.move(dome["x"] + 4, dome["y"] + 4, steps=3)
    page.mouse.move(x + 10, y + 40, steps=6)
    page.mouse.up()
    assert "front" in lamp.get_attribute("aria-valuetext")
