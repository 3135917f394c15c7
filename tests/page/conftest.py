"""A browser without a window, the real service with its own model, and the page."""

from __future__ import annotations

import base64
import os
import shutil
from pathlib import Path

import pytest
from service.servers import Server

CHROMIUM = (
    os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
)
WIDE = {"width": 1440, "height": 900}
NARROW = {"width": 390, "height": 844}
PATIENCE_MS = 30_000
"""A relight on a busy machine."""
DROP = """([files]) => {
    const carried = new DataTransfer();
    for (const {name, type, data} of files) {
        const bytes = Uint8Array.from(atob(data), (character) => character.charCodeAt(0));
        carried.items.add(new File([bytes], name, {type}));
    }
    for (const kind of ["dragenter", "dragover", "drop"])
        window.dispatchEvent(new DragEvent(kind, {dataTransfer: carried, cancelable: true}));
}"""


@pytest.fixture(scope="package")  # its event loop keeps others from running until it is closed
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium here; install it, or name it in CHROMIUM")
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture(scope="package")
def server(browser, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    running = Server(folder / "data", folder, measure="true", requests_per_minute=1_000_000).start()
    yield running
    running.stop()
    assert "Traceback" not in running.log.read_text()


@pytest.fixture
def client(server):
    with server.client() as connection:
        yield connection


@pytest.fixture
def visit(browser, server):
    """``visit()``: the page in a fresh browser profile. Whatever its console complains of fails."""
    contexts, complaints = [], []

    def visited(viewport=WIDE, scheme="light", address=server.address, expected=(), **options):
        context = browser.new_context(viewport=viewport, color_scheme=scheme, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)

        def heard(kind, text):
            if kind in ("error", "warning") and not any(known in text for known in expected):
                complaints.append(text)

        page.on("console", lambda message: heard(message.type, message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(address)
        return page

    yield visited
    for context in contexts:
        context.close()
    assert complaints == []


def drop(page, *paths: Path) -> None:
    """Drop files on the page, as a hand would."""
    types = {
        ".jpg": "image/jpeg",
        ".obj": "model/obj",
        ".png": "image/png",
        ".txt": "text/plain",
        ".zip": "application/zip",
    }
    files = [
        {
            "name": path.name,
            "type": types[path.suffix],
            "data": base64.b64encode(path.read_bytes()).decode(),
        }
        for path in paths
    ]
    page.evaluate(DROP, [files])


def take_sample(page, name="Goblet"):
    """Start with a scene that comes along, and wait until its light is sketched."""
    page.get_by_role("button", name=name).click()
    page.locator("#sketch").wait_for()


def sketched(page, act):
    """Do something that changes the light; wait for its sketch."""
    before = page.locator("#sketch").get_attribute("src")
    act()
    page.wait_for_function("before => document.querySelector('#sketch').src !== before", arg=before)


def relit(page):
    """Ask for a draft, and wait for it."""
    page.get_by_text("Draft", exact=True).click()
    page.get_by_role("button", name="Relight").click()
    page.locator("#takeaway").wait_for()
