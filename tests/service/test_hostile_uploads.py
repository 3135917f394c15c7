"""Whatever is sent is refused cleanly, and the service goes on."""

from __future__ import annotations

import io
import socket
import time

import httpx
import pytest

from spotlight_service.engine.studio import StudioDesk
from spotlight_service.engine.uploads import check_bundle, check_picture, unpack_bundle
from spotlight_service.problems import FieldError, ProblemError
from spotlight_service.settings import Settings

from .hostile import CASES, GOOD, JPEG, archive, cutout, picture
from .servers import Server


@pytest.fixture(scope="module")
def guarded(tmp_path_factory, models):
    """A service with limits low enough to test."""
    limits = {
        "max_unpacked_bytes": 20_000_000,
        "max_upload_bytes": 5_000_000,
        "max_json_bytes": 100_000,
        "max_pixels": 1_000_000,
        "studio_s": 30,
        "upload_s": 2,
    }
    data = tmp_path_factory.mktemp("guarded") / "data"
    running = Server(data, models, "--model", "tiny", **limits).start()
    yield running
    running.stop()


def refused(answer: httpx.Response, *statuses: int) -> dict:
    assert answer.status_code in statuses, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["detail"]
    return problem


def test_there_are_enough_of_them():
    assert len(CASES) >= 40


@pytest.mark.parametrize("name", CASES)
def test_hostile_uploads_are_refused(guarded, name):
    files, statuses = CASES[name]()
    names = {field: (f"../../{field}.png", data, "image/png") for field, data in files.items()}
    answer = httpx.post(f"{guarded.address}/v1/scenes", files=names, timeout=60)
    problem = refused(answer, *statuses)
    for secret in (str(guarded.data), "scratch", ".draft", "root:"):
        assert secret not in answer.text, problem
    leftovers = [p.name for p in (guarded.data / "scenes").iterdir()]
    assert leftovers == [], "something of it was kept"


def test_good_uploads_get_through_after_all_that(guarded):
    files = {"photo": picture(size=(96, 128)), "object": cutout()}
    fields = {"at": "0.5,0.9", "height": "0.3", "horizon": "0.2"}
    answer = httpx.post(f"{guarded.address}/v1/scenes", files=files, data=fields, timeout=60)
    assert answer.status_code == 201, answer.text
    scene = answer.json()
    assert (scene["width"], scene["height"]) == (128, 96)
    assert 0.0 < scene["coverage"] < 0.5


def test_a_body_that_is_too_large_is_refused_by_its_announcement(guarded):
    with socket.create_connection(("127.0.0.1", guarded.port)) as connection:
        connection.sendall(
            b"POST /v1/scenes HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99999999999\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n\r\n"
        )
        assert connection.recv(4096).startswith(b"HTTP/1.1 413")


def test_a_body_that_is_too_large_without_saying_so(guarded):
    def endless():
        yield b'--x\r\nContent-Disposition: form-data; name="photo"; filename="a"\r\n\r\n'
        for _ in range(100):
            yield b"\0" * 100_000

    headers = {"Content-Type": "multipart/form-data; boundary=x"}
    try:
        answer = httpx.post(
            f"{guarded.address}/v1/scenes", content=endless(), headers=headers, timeout=30
        )
    except httpx.TransportError:
        return  # hung up on in the middle, which is an answer, too
    refused(answer, 413)


def test_json_has_a_limit_of_its_own(guarded):
    body = {"scene": "0" * 64, "lights": [{"shadow": "A" * 200_000}]}
    refused(httpx.post(f"{guarded.address}/v1/relight", json=body), 413)


def test_a_body_that_drips_is_cut_off(guarded):
    with socket.create_connection(("127.0.0.1", guarded.port)) as connection:
        connection.sendall(
            b"POST /v1/relight HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n"
            b"Content-Type: application/json\r\n\r\n{"
        )
        connection.settimeout(20.0)
        began = time.monotonic()
        assert connection.recv(4096).startswith(b"HTTP/1.1 408")
        assert time.monotonic() - began >= 1.0


@pytest.mark.parametrize(
    "shadow",
    ["http://169.254.169.254/x.png", "data:image/svg+xml,<svg/>", "file:///etc/passwd", "####"],
)
def test_drawings_are_never_fetched(guarded, shadow, bundle):
    with guarded.client() as client:
        scene = client.upload(bundle)
    body = {"scene": scene.id, "lights": [{"shadow": shadow}], "model": "tiny"}
    for path in ("/v1/relight", f"/v1/scenes/{scene.id}/shadow"):
        sent = body if path == "/v1/relight" else {"lights": body["lights"]}
        problem = refused(httpx.post(guarded.address + path, json=sent), 415, 422)
        assert problem["errors"][0]["field"] == "lights[0].shadow"


def test_a_studio_that_takes_too_long_is_replaced(tmp_path):
    desk = StudioDesk(Settings(data=tmp_path, studio_s=0.05))
    try:
        with pytest.raises(ProblemError) as caught:
            desk.ask("sample", name="goblet", draft_folder=str(tmp_path))
        assert caught.value.status == 413
        patient = StudioDesk(Settings(data=tmp_path))
        patient.warm()
        first = patient._child.process
        first.kill()
        first.wait()
        answer, _ = patient.ask("sample", name="goblet", draft_folder=str(tmp_path))
        assert answer["info"]["width"] == 256
        patient.close()
        with pytest.raises(ProblemError, match="shutting down"):
            patient.ask("sample", name="goblet", draft_folder=str(tmp_path))
    finally:
        desk.close()


def test_a_bundle_as_finder_zips_it(tmp_path):
    zipped = {f"chair/{name}": data for name, data in GOOD.items()}
    added = {"chair/.DS_Store": b"Bud1", "__MACOSX/._chair": b"\0\5\x16\7"}
    added |= {f"__MACOSX/chair/._{name}": b"\0\5\x16\7" for name in GOOD}
    (tmp_path / "a.zip").write_bytes(archive({**zipped, **added}))
    found = unpack_bundle(
        tmp_path / "a.zip", tmp_path / "out", most_bytes=10**6, most_files=len(GOOD)
    )
    assert found == tmp_path / "out/chair"
    assert {path.name for path in found.iterdir()} == set(GOOD)
    check_bundle(found, 10**6, 10**6)


def test_large_pictures_are_not_taken_for_archives_by_chance():
    noise = JPEG[:-2] + b"PK\x05\x06" + b"\x07" * 60 + b"\xff\xd9"
    assert check_picture("photo", noise, 10**6) == ".jpg"
    with pytest.raises(FieldError, match="archive"):
        check_picture("photo", JPEG + archive({"a.png": b"x"}), 10**6)


def test_an_archive_within_a_picture_is_found_by_what_unpackers_look_for():
    import zipfile

    both = JPEG + archive({"a.png": b"x"})
    assert zipfile.is_zipfile(io.BytesIO(both))
