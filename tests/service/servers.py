"""A real service in a process of its own, to be started, killed and started again."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx

from spotlight_service.client import Client

PATIENCE_S = 60.0


class Server:
    """``python -m spotlight_service`` on a free port, with whatever settings are named."""

    def __init__(
        self,
        data: Path,
        models: Path,
        *arguments: str,
        warnings: str = "error",
        patience: float = PATIENCE_S,
        **settings: object,
    ) -> None:
        self._patience = patience
        self.data, self.log = data, data.parent / f"{data.name}.log"
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}"
        self._arguments = ["--data", str(data), "--port", str(self.port), *arguments]
        self._environment = {
            **os.environ,
            "SPOTLIGHT_MODELS": str(models),
            "XDG_CACHE_HOME": str(models / "cache"),
            "SPOTLIGHT_SERVE_THREADS": "1",
            "SPOTLIGHT_SERVE_MEASURE": "false",
            "PYTHONWARNINGS": warnings,
            **{f"SPOTLIGHT_SERVE_{name.upper()}": str(value) for name, value in settings.items()},
        }
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, ready: bool = True) -> Server:
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "spotlight_service", *self._arguments],
                env=self._environment,
                stdout=log,
                stderr=log,
            )
        try:
            self.wait_for("/v2/health/ready" if ready else "/v2/health/live")
        except AssertionError:
            self.stop()
            raise
        return self

    def wait_for(self, path: str) -> None:
        until = time.monotonic() + self._patience
        while time.monotonic() < until:
            assert self.process is not None
            if self.process.poll() is not None:
                raise AssertionError(f"the service ended: {self.log.read_text()[-2000:]}")
            try:
                if httpx.get(self.address + path, timeout=5.0).status_code == 200:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.05)
        raise AssertionError(f"{path} was never answered: {self.log.read_text()[-2000:]}")

    def kill(self) -> None:
        """As a power cut would."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """As systemd would; returns the exit code."""
        assert self.process is not None
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(self._patience)

    def client(self, key: str | None = None) -> Client:
        return Client(self.address, key)
