"""Files of jobs: drawings they came with, previews, results. One folder a job."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

from spotlight_spec import replacing

__all__ = ["JobFiles", "require_space"]


class JobFiles:
    """Folders below ``jobs/``.

    Parameters
    ----------
    root : Path
        Made where it does not exist.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir(parents=True, exist_ok=True)

    def folder(self, job: str) -> Path:
        """The folder of a job; made when it is first written to."""
        return self.root / job

    def drawing(self, job: str, number: int, kind: str) -> Path:
        """A drawn shadow the job came with; ``kind`` is ``shadow`` or ``negative``."""
        return self.root / job / f"{kind}-{number}.png"

    def picture(self, job: str, light: int | None = None) -> Path:
        """The result, or what one light of a sweep makes of the scene, as PNG, eight bits."""
        return self.root / job / f"{_result(light)}.png"

    def pixels(self, job: str, light: int | None = None) -> Path:
        """The same as float16 array, sRGB-encoded: what formats with more than 8 bits need."""
        return self.root / job / f"{_result(light)}.npy"

    def preview(self, job: str) -> Path:
        """The latest look at a job that runs."""
        return self.root / job / "preview.jpg"

    def write(self, path: Path, data: bytes) -> None:
        """Write a file of a job; write-then-rename."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as partial:
            partial.write_bytes(data)

    def forget(self, job: str) -> None:
        """Remove all files of a job."""
        shutil.rmtree(self.root / job, ignore_errors=True)

    def strays(self, known: set[str], age: float, now: float) -> list[str]:
        """Folders older than ``age`` seconds that belong to no job any more."""
        return [
            entry.name
            for entry in os.scandir(self.root)
            if entry.name not in known and now - entry.stat().st_mtime > age
        ]


def _result(light: int | None) -> str:
    return "result" if light is None else f"result-{light}"


def require_space(folder: Path, least: int) -> None:
    """Raise as a full disk would, while there is still room to work in.

    Raises
    ------
    OSError
        ENOSPC.
    """
    if shutil.disk_usage(folder).free < least:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
