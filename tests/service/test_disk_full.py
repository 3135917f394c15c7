"""A full disk is said to be one, and nothing is half stored."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import subprocess

import httpx
import pytest

from spotlight_service.client import ServiceError
from spotlight_service.problems import of_error
from spotlight_service.storage.files import require_space

from .servers import Server

LIGHT = {"azimuth": 200.0, "elevation": 40.0}
SIZE = 24 << 20


@pytest.fixture
def small_disk(tmp_path):
    """A disk of a few megabytes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounting = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mounting, check=False).returncode != 0:
        pytest.skip("this needs the right to mount a small disk")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def refused(call) -> None:
    with pytest.raises(ServiceError) as caught:
        call()
    assert caught.value.status == 507, caught.value
    assert "disk" in caught.value.problem["detail"]


def filled(path):
    """Write until nothing fits any more."""
    with path.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(b"\0" * 4096)


def test_a_disk_that_runs_full_under_the_service(small_disk, models, bundle):
    server = Server(small_disk / "data", models, "--model", "tiny", min_free_bytes=0)
    server.log = small_disk.parent / "service.log"
    server.start()
    try:
        with server.client() as client:
            scene = client.upload(bundle)
            before = client.wait(client.relight(scene, [LIGHT], model="tiny"))
            picture = client.result(before)
            waiting = client.relight(scene, [LIGHT], model="tiny", steps=1000)
            ballast = small_disk / "ballast"
            filled(ballast)
            refused(lambda: client.upload(bundle))
            body = {"scene": scene.id, "lights": [LIGHT], "model": "tiny"}
            big = {"lights": [LIGHT], "scene": scene.id, "model": "tiny", "seed": 4}
            for sent in (body, big):
                answer = httpx.post(f"{server.address}/v1/relight", json=sent)
                assert answer.status_code in (202, 507), answer.text
            assert client.result(before) == picture, "what was there is there"
            ballast.unlink()
            assert client.upload(bundle) == scene
            ended = client.wait(waiting)
            assert ended.state in ("done", "failed")
            if ended.state == "failed":
                assert ended.facts["error"]["status"] == 507
            after = client.wait(client.relight(scene, [LIGHT], model="tiny"))
            assert client.result(after) == picture
    finally:
        server.stop()


def test_space_is_left_free(tmp_path):
    require_space(tmp_path, 1)
    with pytest.raises(OSError, match="space") as caught:
        require_space(tmp_path, 1 << 60)
    problem = of_error(caught.value)
    assert problem.status == 507
    assert str(tmp_path) not in problem.detail


def test_a_full_disk_is_known_by_whatever_name_it_comes(tmp_path):
    connection = sqlite3.connect(tmp_path / "small.db")
    connection.execute("PRAGMA max_page_count = 2")
    with pytest.raises(sqlite3.OperationalError) as caught:
        connection.execute("CREATE TABLE a AS SELECT zeroblob(100000)")
    connection.close()
    assert of_error(caught.value).status == 507
    assert of_error(OSError(5, "input/output error")).status == 500
