"""Fetches the ambient panoramas.

CC0 images that Blender's Python package carries as studio lights.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from . import kinds
from .sky import default_folder

PACKAGE = "bpy==4.5.15"
_INSIDE = "datafiles/studiolights/world/"
# The wheel is for one Python only, and only read as an archive here.
_PLATFORM = (
    "--python-version",
    "3.11",
    "--platform",
    "manylinux_2_28_x86_64",
    "--only-binary",
    ":all:",
)


def fetch(folder: Path | None = None) -> list[Path]:
    """Download the package (370 MB), keep its panoramas (2 MB) and return their paths.

    Panoramas that are there already are kept and nothing is downloaded if all are.

    Raises
    ------
    RuntimeError
        If the package cannot be downloaded or lacks an image.
    """
    place = folder or default_folder()
    names = sorted({name for split in kinds.HDRIS.values() for name in split})
    paths = [place / f"{name}.exr" for name in names]
    if all(path.exists() for path in paths):
        return paths
    place.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place) as scratch:
        command = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--quiet",
            "--no-deps",
            *_PLATFORM,
            "-d",
            scratch,
            PACKAGE,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        wheels = list(Path(scratch).glob("*.whl"))
        if done.returncode or not wheels:
            reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise RuntimeError(
                f"hdris: pip could not download {PACKAGE} ({reason}). Try again later, or put "
                f"{', '.join(p.name for p in paths)} into {place} yourself; "
                "'spotlight-train render --no-hdris' needs none."
            )
        return _unpack(wheels[0], place, paths)


def _unpack(wheel: Path, place: Path, paths: list[Path]) -> list[Path]:
    with zipfile.ZipFile(wheel) as archive:
        members = {Path(name).name: name for name in archive.namelist() if _INSIDE in name}
        missing = [path.name for path in paths if path.name not in members]
        if missing:
            raise RuntimeError(
                f"hdris: expected {', '.join(missing)} inside {wheel.name}, found "
                f"{', '.join(sorted(members))}."
            )
        (place / "LICENSE.txt").write_bytes(archive.read(members["license.txt"]))
        for path in paths:
            path.write_bytes(archive.read(members[path.name]))
    return paths
