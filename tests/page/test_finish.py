"""What every visitor may expect: readable, operable, at every width and in both schemes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import spotlight_service

from .conftest import NARROW, WIDE, relit, take_sample

PAGE = Path(spotlight_service.__file__).parent / "page"
SERIOUS = ("serious", "critical")


def serious(page):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(page).response["violations"]
    return [
        (each["id"], node["target"], node.get("failureSummary"))
        for each in found
        if each["impact"] in SERIOUS
        for node in each["nodes"]
    ]


@pytest.mark.parametrize(("viewport", "scheme"), [(WIDE, "dark"), (NARROW, "light")])
def test_nothing_serious_for_axe(visit, viewport, scheme):
    page = visit(viewport, scheme)
    page.locator(".sample img").last.wait_for()
    assert serious(page) == []
    take_sample(page)
    page.get_by_role("button", name="Add a light").click()
    assert serious(page) == []
    page.get_by_role("radio", name="Paint its shadow").check()
    assert serious(page) == []
    page.get_by_role("button", name="Remove this light").click()
    relit(page)
    assert serious(page) == []


@pytest.mark.parametrize("width", [320, 390, 768, 1024, 1440])
def test_nothing_sticks_out_sideways(visit, width):
    page = visit({"width": width, "height": 844})
    take_sample(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for part in ("#controls", "#library"):
        inner, outer = page.locator(part).evaluate("e => [e.scrollWidth, e.clientWidth]")
        assert inner <= outer


def test_the_scheme_that_is_chosen_outlives_a_reload(visit):
    page = visit(scheme="light")

    def ground():
        return page.evaluate("getComputedStyle(document.documentElement).backgroundColor")

    light = ground()
    page.get_by_role("radio", name="Dark").check()
    dark = ground()
    assert dark != light
    page.reload()
    assert ground() == dark
    assert page.get_by_role("radio", name="Dark").is_checked()


def test_nothing_is_inline_or_from_elsewhere():
    html = (PAGE / "index.html").read_text()
    assert not re.search(r"<style|\sstyle=|\son\w+=|<script(?![^>]*\ssrc=)", html)
    for path in PAGE.iterdir():
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"(?:https?:)?//[a-z0-9-]+\.[a-z]{2,}", text), path.name


def test_files_are_small_enough_to_read():
    for path in PAGE.iterdir():
        assert len(path.read_text().splitlines()) <= 300, path.name


@pytest.mark.full
def test_a_key_is_asked_for_and_used(visit, tmp_path):
    import subprocess
    import sys

    from service.servers import Server

    data = tmp_path / "data"
    adding = [sys.executable, "-m", "spotlight_service", "keys", "add", "shop", "--data", str(data)]
    key = subprocess.run(adding, capture_output=True, text=True, check=True).stdout.split()[-1]
    guarded = Server(data, tmp_path).start()
    try:
        page = visit(address=guarded.address, expected=["401"])
        page.get_by_label("API key").fill(key)
        page.get_by_role("button", name="Use it").click()
        take_sample(page)
        page.close()  # or it would go on asking a service that is gone
    finally:
        guarded.stop()
