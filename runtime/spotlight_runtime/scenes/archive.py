"""A scene folder out of a zip, which may mean harm."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Final

from spotlight_runtime.errors import SceneError, UnsafePathError

__all__ = ["MAX_ZIP_BYTES", "MAX_ZIP_ENTRIES", "unpack"]

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
            _check_entries(bundle, archive, folder)
            bundle.extractall(folder)
    except SceneError:
        raise
    except Exception as error:  # what zipfile and its decompressors raise shares no base class
        raise SceneError(f"{archive}: cannot be unpacked: {error}") from error
    entries = list(folder.iterdir())
    return entries[0] if len(entries) == 1 and entries[0].is_dir() else folder


def _check_entries(bundle: zipfile.ZipFile, archive: Path, folder: Path) -> None:
    total, count = 0, len(bundle.infolist())
    if count > MAX_ZIP_ENTRIES:
        raise SceneError(
            f"{archive}: holds {count} files, more than the limit of {MAX_ZIP_ENTRIES}; "
            "zip the scene's own files only"
        )
    for entry in bundle.infolist():
        total += entry.file_size
        if not (folder / entry.filename).resolve().is_relative_to(folder.resolve()):
            raise UnsafePathError(f"{archive}: {entry.filename!r} lies outside the bundle")
    if total > MAX_ZIP_BYTES:
        raise SceneError(
            f"{archive}: unpacks to {total} bytes, more than the limit of {MAX_ZIP_BYTES}; "
            "load the unpacked folder instead"
        )
