"""Starting a service: what is wrong is one line, and nothing is touched before it is right."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest
from pydantic import ValidationError

from spotlight_service.command import main
from spotlight_service.settings import Settings


def started(data, models, port) -> str:
    """The one line of a service that does not start."""
    command = [sys.executable, "-m", "spotlight_service", "--data", str(data), "--port", str(port)]
    done = subprocess.run(
        [*command, "--model", "tiny"],
        env={**os.environ, "SPOTLIGHT_MODELS": str(models)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    return line


def test_a_second_service_takes_nothing_from_the_first(server, models):
    upload = server.data / "scratch" / "upload"
    upload.write_bytes(b"on its way")
    assert "another service uses this data folder" in started(server.data, models, 0)
    assert upload.read_bytes() == b"on its way"
    upload.unlink()


def test_a_port_that_is_taken(tmp_path, models):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        line = started(tmp_path / "data", models, port)
    assert f"got 127.0.0.1:{port} (Address already in use); choose another" in line
    assert not (tmp_path / "data" / "scratch").exists()


@pytest.mark.parametrize(
    ("arguments", "environment", "told"),
    [
        (["--port", "99999"], {}, "port: expected a number of at most 65535, got 99999"),
        (["--queue", "0"], {}, "queue: expected a number of at least 1, got 0"),
        ([], {"PORT": "http"}, "port: expected a whole number, got 'http'"),
        ([], {"MODELS": " , "}, "models: expected a list of at least 1, got ()"),
    ],
)
def test_settings_that_cannot_be(monkeypatch, capsys, arguments, environment, told):
    monkeypatch.setattr(sys, "argv", ["spotlight-serve", *arguments])
    for name, value in environment.items():
        monkeypatch.setenv(f"SPOTLIGHT_SERVE_{name}", value)
    with pytest.raises(SystemExit, match="1"):
        main()
    assert capsys.readouterr().err == f"spotlight-serve: {told}\n"


@pytest.mark.parametrize("text", ["mini,other", " mini , other ", '["mini", "other"]'])
def test_models_of_the_environment(monkeypatch, text):
    monkeypatch.setenv("SPOTLIGHT_SERVE_MODELS", text)
    assert Settings().models == ("mini", "other")


def test_a_service_has_a_model():
    with pytest.raises(ValidationError):
        Settings(models=())
