"""Processes of their own for things that must not happen to the tests' process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

__all__ = ["environment", "in_a_namespace", "python", "spotlight"]

TESTS = Path(__file__).parents[1]


def environment(**more: str) -> dict[str, str]:
    """Of a child: the tests' helpers at hand, one thread, no cache of the person's."""
    return os.environ | {"PYTHONPATH": str(TESTS), "OMP_NUM_THREADS": "1"} | more


def python(script: str, *arguments: object, **more: str) -> subprocess.CompletedProcess[str]:
    """Run a script to its end."""
    command = [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment(**more), check=False
    )


def spotlight(*arguments: object) -> list[str]:
    """The command line of ``spotlight`` with these arguments."""
    main = "from spotlight_runtime.cli import main; main()"
    return [sys.executable, "-c", main, *map(str, arguments)]


def in_a_namespace(shell: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a shell script whose mounts nobody else sees and that end with it.

    Skips where that needs rights that are not there.
    """
    unshare = shutil.which("unshare")
    prefix = [unshare or "", "--mount", "--propagation", "private"]
    probe = [*prefix, "mount", "-t", "tmpfs", "-o", "size=64k", "none", "/mnt"]
    if unshare is None or subprocess.run(probe, capture_output=True, check=False).returncode:
        pytest.skip("mounting file systems needs root and unshare")
    command = [*prefix, "sh", "-ec", textwrap.dedent(shell), "sh", *map(str, arguments)]
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=environment(PYTHON=sys.executable),
        check=False,
    )
