"""Processes that serve this one, each at the other end of a socket.

What is said is JSON, and bytes: a decoder that was taken over cannot make its parent unpickle.
A child whose parent is gone notices, because the socket ends.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
from multiprocessing.connection import Connection
from typing import Any

__all__ = ["Child", "parent", "receive", "send"]


def send(connection: Connection, value: dict[str, Any]) -> None:
    """Say something."""
    connection.send_bytes(json.dumps(value).encode())


def receive(connection: Connection) -> dict[str, Any]:
    """Wait for what is said.

    Raises
    ------
    EOFError, OSError
        If there is nobody any more.
    """
    value: dict[str, Any] = json.loads(connection.recv_bytes())
    return value


class Child:
    """A Python module in a process of its own.

    Parameters
    ----------
    module : str
        Run as ``python -m``.
    config : dict
        The first thing it is told.
    """

    def __init__(self, module: str, config: dict[str, Any]) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", module, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
            )
        self.connection = Connection(ours.detach())
        send(self.connection, config)

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self.process.poll() is None

    def stop(self, patience: float) -> None:
        """Ask it to stop, and kill it where it does not."""
        with contextlib.suppress(OSError):  # it may be gone already
            send(self.connection, {"stop": True})
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.connection.close()

    def kill(self) -> None:
        """End it at once."""
        self.process.kill()
        self.process.wait()
        self.connection.close()


def parent() -> tuple[Connection, dict[str, Any]]:
    """In a child: the connection to its parent, and what it was told first."""
    connection = Connection(int(sys.argv[1]))
    os.set_inheritable(connection.fileno(), False)
    return connection, receive(connection)
