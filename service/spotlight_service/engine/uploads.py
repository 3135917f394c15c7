"""What uploads are let in, decided by their bytes before anything decodes them.

Names and declared types are the sender's word and count for nothing: a file gets its suffix from
its content. What is two things at once (a picture that is also an archive, or a web page) is
refused, and what is let in is never sent back as it came.
"""

from __future__ import annotations

import hashlib
import json
import stat
import zipfile
from pathlib import Path, PurePosixPath
from typing import Final

from spotlight_runtime.errors import ImageFileError
from spotlight_runtime.imaging.headers import read_header
from spotlight_runtime.scenes.archive import own_entries, scene_folder
from spotlight_service.problems import FieldError

__all__ = [
    "bundle_digest",
    "check_picture",
    "digest_of",
    "kind_of",
    "model_suffix",
    "unpack_bundle",
]

_SIGNATURES: Final = {
    b"\x89PNG\r\n\x1a\n": ".png",
    b"\xff\xd8\xff": ".jpg",
    b"#?": ".hdr",
    b"\x76\x2f\x31\x01": ".exr",
}
_FOREIGN: Final = {
    "a web page": (b"<!doctype", b"<html", b"<script", b"<iframe", b"<body"),
    "an SVG drawing": (b"<svg xmlns", b"<svg width", b"<svg onload"),
    "a PDF document": (b"%pdf-1", b"%pdf-2"),
    "a program": (b"<?php", b"#!/bin/", b"#!/usr/", b"\x7felf\x02\x01\x01"),
}
_BUNDLE_SUFFIXES: Final = {
    *(".json", ".png", ".jpg", ".jpeg", ".webp", ".hdr", ".exr", ".npz", ".glb", ".obj", ".mtl")
}
_PICTURES: Final = {".png", ".jpg", ".jpeg", ".webp", ".hdr", ".exr"}
_CHUNK: Final = 1 << 20
_ZIP_TAIL: Final = (1 << 16) + 22
"""Bytes from the end within which an archive's directory is announced."""
_EXR_HEAD: Final = 1 << 16
_SMALLEST_CENTRAL: Final = 46
_WHAT: Final = "a PNG, JPEG, WebP, Radiance HDR or OpenEXR picture"


def kind_of(data: bytes) -> str | None:
    """Suffix of the picture format that bytes begin as; None if they are no picture."""
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return ".webp"
    return next((suffix for magic, suffix in _SIGNATURES.items() if data.startswith(magic)), None)


def check_picture(field: str, data: bytes, most_pixels: int) -> str:
    """Look at a picture without decoding it.

    Parameters
    ----------
    field : str
        Named in errors.
    data : bytes
    most_pixels : int

    Returns
    -------
    str
        The suffix its content calls for.

    Raises
    ------
    FieldError
        415 for what is no picture, or something else, too; 413 for one that is too large.
    """
    suffix = kind_of(data)
    if suffix is None:
        raise FieldError(field, _WHAT, _described(data), status=415)
    try:
        header = read_header(data)
    except (ImageFileError, ValueError, IndexError):
        header = None
    if header is None or header.width <= 0 or header.height <= 0:
        raise FieldError(field, _WHAT, "one whose header is damaged", status=415)
    if header.width * header.height > most_pixels:
        got = f"{header.width}×{header.height}"
        raise FieldError(field, f"at most {most_pixels} pixels", got, status=413)
    foreign = _foreign(data)
    if foreign is not None:
        raise FieldError(
            field, "a picture and nothing else", f"one that is {foreign}, too", status=415
        )
    return suffix


def model_suffix(field: str, data: bytes) -> str:
    """Suffix of the 3-D model that bytes are, judged by their content.

    Raises
    ------
    FieldError
        415 if they are none.
    """
    if data.startswith(b"glTF"):
        return ".glb"
    what = "a picture with transparency, or a model (.glb, self-contained .gltf, .obj)"
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise FieldError(field, what, _described(data), status=415) from None
    foreign = _foreign(data)
    if foreign is not None:
        raise FieldError(field, what, foreign, status=415)
    if text.lstrip().startswith("{"):
        try:
            tree = json.loads(text)
        except (ValueError, RecursionError):
            tree = None
        if isinstance(tree, dict) and "asset" in tree:
            return ".gltf"
    elif any(line.startswith("v ") for line in text.splitlines()):
        return ".obj"
    raise FieldError(field, what, _described(data), status=415)


def unpack_bundle(archive: Path, folder: Path, *, most_bytes: int, most_files: int) -> Path:
    """Unpack a zipped scene, file by file and no further than allowed.

    Parameters
    ----------
    archive, folder : Path
    most_bytes : int
        Of all files together, counted as they come out: what the archive says of itself is not
        believed.
    most_files : int

    Returns
    -------
    Path
        The folder that holds ``scene.json`` or a published scene.

    Raises
    ------
    FieldError
    """
    if not zipfile.is_zipfile(archive):
        with archive.open("rb") as file:
            raise FieldError("bundle", "a zip file", _described(file.read(64)), status=415)
    left = most_bytes
    try:
        with zipfile.ZipFile(archive) as bundle:
            entries = [e for e in own_entries(bundle) if not e.is_dir()]
            if len(entries) > most_files:
                got = f"{len(entries)}"
                raise FieldError("bundle", f"at most {most_files} files", got, status=413)
            _check_names(entries)
            for entry in entries:
                target = folder / entry.filename
                target.parent.mkdir(parents=True, exist_ok=True)
                with bundle.open(entry) as source, target.open("xb") as sink:
                    while chunk := source.read(_CHUNK):
                        left -= len(chunk)
                        if left < 0:
                            expected = f"at most {most_bytes} bytes unpacked"
                            raise FieldError("bundle", expected, "more", status=413)
                        sink.write(chunk)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError) as error:
        raise FieldError("bundle", "a whole zip file", error, status=422) from error
    except FileExistsError as error:
        raise FieldError("bundle", "each file once", "one twice") from error
    return scene_folder(folder)


def check_bundle(folder: Path, most_pixels: int, most_bytes: int) -> None:
    """Look at every file of an unpacked scene without decoding it.

    Parameters
    ----------
    folder : Path
    most_pixels : int
        Of any picture.
    most_bytes : int
        Of any mesh, unpacked.

    Raises
    ------
    FieldError
    """
    for path in sorted(folder.rglob("*")):
        if not path.is_file():
            continue
        name, suffix = path.relative_to(folder).as_posix(), path.suffix.lower()
        if suffix in _PICTURES:
            found = check_picture(f"bundle: {name}", path.read_bytes(), most_pixels)
            if found != {".jpeg": ".jpg"}.get(suffix, suffix):
                raise FieldError(
                    f"bundle: {name}", f"a {suffix} file", f"a {found} file", status=415
                )
        elif suffix == ".npz":  # an archive of arrays
            _check_arrays(f"bundle: {name}", path, most_bytes)
        else:
            foreign = _foreign(path.read_bytes())
            if foreign is not None:
                raise FieldError(f"bundle: {name}", "a scene's file", foreign, status=415)


def _check_arrays(field: str, path: Path, most_bytes: int) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise FieldError(field, "arrays as numpy saves them", error, status=415) from error
    if size > most_bytes:
        raise FieldError(field, f"at most {most_bytes} bytes unpacked", size, status=413)


def bundle_digest(folder: Path) -> str:
    """Name of an unpacked scene: SHA-256 of its files' names and contents."""
    total = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        total.update(path.relative_to(folder).as_posix().encode() + b"\0")
        total.update(bytes.fromhex(digest_of(path)))
    return total.hexdigest()


def digest_of(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_names(entries: list[zipfile.ZipInfo]) -> None:
    for entry in entries:
        name = entry.filename
        path = PurePosixPath(name)
        unsafe = (
            path.is_absolute()
            or ".." in path.parts
            or "\\" in name
            or ":" in name
            or "\0" in entry.orig_filename
            or len(path.parts) > 3
        )
        if unsafe:
            raise FieldError("bundle", "names inside the archive", repr(name)[:80])
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise FieldError("bundle", "files", f"a link, {name!r}")
        if entry.flag_bits & 0x1:
            raise FieldError("bundle", "files without a password", f"{name!r} with one")
        if path.suffix.lower() not in _BUNDLE_SUFFIXES:
            known = ", ".join(sorted(_BUNDLE_SUFFIXES))
            raise FieldError("bundle", f"files ending in {known}", repr(name)[:80], status=415)


def _foreign(data: bytes) -> str | None:
    """What bytes are besides what they should be."""
    lowered = data.lower()
    for what, marks in _FOREIGN.items():
        if any(mark in lowered for mark in marks):
            return what
    return "an archive" if _holds_archive(data) else None


def _holds_archive(data: bytes) -> bool:
    """Whether unpackers would take the bytes for a zip file: a directory is announced at the end.

    The four letters alone occur by chance in large pictures; a directory that fits does not.
    """
    start = max(0, len(data) - _ZIP_TAIL)
    found = data.find(b"PK\x05\x06", start)
    while found >= 0:
        size = int.from_bytes(data[found + 12 : found + 16], "little")
        if found >= size >= _SMALLEST_CENTRAL and data[found - size :].startswith(b"PK\x01\x02"):
            return True
        found = data.find(b"PK\x05\x06", found + 1)
    return False


def _described(data: bytes) -> str:
    head = data[:1024].lower().lstrip()
    if not head:
        return "an empty file"
    if b"<svg" in head:
        return "an SVG drawing"
    for what, marks in _FOREIGN.items():
        if any(mark in head for mark in marks):
            return what
    if head.startswith(b"pk"):
        return "an archive"
    return "other bytes"
