"""A scene folder out of a zip, which may mean harm."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Final

from spotlight_runtime.errors import SceneError, UnsafePathError

__all__ = ["MAX_ZIP_BYTES", "MAX_ZIP_ENTRIES", "own_entries", "scene_folder", "unpack"]

MAX_ZIP_BYTES: Final = 1 << 30
"""Of everything unpacked: more than a scene of the largest picture taken."""
MAX_ZIP_ENTRIES: Final = 2000
"""A scene has some twenty files; with ready shadows of many lights, hundreds."""


def unpack(archive: Path, folder: Path) -> Path:
    """Unpack a zipped scene into ``folder`` and return the folder that holds the scene.

    Raises
    ------
    UnsafePathError
        If an entry would be written outside ``folder``.
    SceneError
        If the archive is damaged or unpacks to more than the limit.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with zipfile.ZipFile(archive) as bundle:
            entries = own_entries(bundle)
            _check_entries(entries, archive, folder)
            bundle.extractall(folder, entries)
    except SceneError:
        raise
    except Exception as error:  # what zipfile and its decompressors raise shares no base class
        raise SceneError(f"{archive}: cannot be unpacked: {error}") from error
    return scene_folder(folder)


def own_entries(bundle: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """What was put into a zip, without what file managers add: ``__MACOSX/``, ``.DS_Store``."""

    def added(part: str) -> bool:
        return part == "__MACOSX" or (part.startswith(".") and not part.startswith(".."))

    return [
        entry
        for entry in bundle.infolist()
        if not any(added(part) for part in PurePosixPath(entry.filename).parts)
    ]


def scene_folder(unpacked: Path) -> Path:
    """The folder that holds the scene: what a zip was unpacked to, or the only folder in it."""
    inside = list(unpacked.iterdir())
    return inside[0] if len(inside) == 1 and inside[0].is_dir() else unpacked


def _check_entries(entries: Sequence[zipfile.ZipInfo], archive: Path, folder: Path) -> None:
    total = 0
    if len(entries) > MAX_ZIP_ENTRIES:
        raise SceneError(
            f"{archive}: holds {len(entries)} files, more than the limit of {MAX_ZIP_ENTRIES}; "
            "zip the scene's own files only"
        )
    for entry in entries:
        total += entry.file_size
        if not (folder / entry.filename).resolve().is_relative_to(folder.resolve()):
            raise UnsafePathError(f"{archive}: {entry.filename!r} lies outside the bundle")
    if total > MAX_ZIP_BYTES:
        raise SceneError(
            f"{archive}: unpacks to {total} bytes, more than the limit of {MAX_ZIP_BYTES}; "
            "load the unpacked folder instead"
        )
