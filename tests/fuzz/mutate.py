"""Mutations that know a little of the formats, so that what they make gets past the first check."""

from __future__ import annotations

import copy
import io
import json
import random
import struct
import zipfile
from collections.abc import Callable
from typing import Any

from support.models import glb

from fuzz import seeds

__all__ = ["mutate"]

Flip = Callable[[bytes, int], bytes]
_VALUES: list[Any] = [
    None, True, 0, -1, 1, 2, 2**31, 2**63, 10**20, 10**400, 1e308, -1e-320, 0.5, "", ".", "..",
    "/", "a\0b", "../x.png", "/etc/passwd", "n" * 300, "\ud800", [], {}, [0], [1, 2], [[1]],
    "data:,", "data:;base64,AAAA", "http://a/b", "scene.json", "part.png", "srgb",
]  # fmt: skip
_WORDS = [
    b"0", b"-1", b"1e999", b"nan", b"inf", b"99999999999", b"//", b"/", b" ", b"\n", b"\\\n",
    b"usemtl", b"mtllib ../a.mtl", b"map_Kd /etc/passwd", b"f 1 1 1", b"f 1 2 999999999", b"v",
    b"Kd", b"d ", b"Ns", b"vt nan nan", b"g", b"o", b"\0", b"newmtl red",
]  # fmt: skip
_NUMBERS = [0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]


def mutate(shape: str, data: bytes, rng: random.Random, flip: Flip | None = None) -> bytes:
    """One step away from some bytes.

    Parameters
    ----------
    shape : str
        Of `Target`.
    data : bytes
    rng : random.Random
    flip : callable, optional
        A fuzzer's own mutation of bytes that have no structure.
    """
    flip = flip or (lambda raw, most: _flipped(raw, rng))
    try:
        if shape == "json" and rng.random() < 0.8:
            return _json(data, rng)
        if shape == "glb" and rng.random() < 0.8:
            return _gltf(data, rng)
        if shape == "zip" and rng.random() < 0.7:
            return _zip(data, rng)
        if shape == "text" and rng.random() < 0.5:
            return _text(data, rng)
        if shape == "image" and data.startswith(b"\x89PNG") and rng.random() < 0.7:
            return _png(data, rng, flip)
    except Exception:  # bytes that earlier mutations have spoiled raise of every kind
        pass
    return flip(data, len(data) + 64)


def _flipped(data: bytes, rng: random.Random) -> bytes:
    raw = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        at, kind = rng.randrange(len(raw)), rng.randrange(5)
        if kind == 0:
            raw[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            raw[at] = rng.randrange(256)
        elif kind == 2:
            code = rng.choice(("<I", ">I", "<H", ">H", "B"))
            number = rng.choice(_NUMBERS) & (256 ** struct.calcsize(code) - 1)
            packed = struct.pack(code, number)
            raw[at : at + len(packed)] = packed
        elif kind == 3 and len(raw) > 1:
            del raw[at : at + rng.choice((1, 2, 4, 16, 64, len(raw) - 1))]
            raw = raw or bytearray(b"\0")
        else:
            start = rng.randrange(len(raw))
            raw[at:at] = raw[start : start + rng.choice((1, 4, 16, 64))]
    return bytes(raw)


def _json(data: bytes, rng: random.Random) -> bytes:
    tree = json.loads(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        tree = _changed(tree, rng)
    return json.dumps(tree).encode()


def _changed(tree: Any, rng: random.Random) -> Any:
    """The tree with one of its values replaced, dropped, doubled or moved."""
    places: list[tuple[Any, Any]] = []
    stack = [tree]
    while stack:
        at = stack.pop()
        if isinstance(at, dict | list):
            for key, value in at.items() if isinstance(at, dict) else enumerate(at):
                places.append((at, key))
                stack.append(value)
    if not places:
        return _value(rng)
    holder, key = rng.choice(places)
    other, other_key = rng.choice(places)
    kind = rng.randrange(6)
    if kind <= 1:
        holder[key] = _value(rng)
    elif kind == 2:
        value = holder[key]
        if isinstance(value, int | float) and not isinstance(value, bool):
            holder[key] = rng.choice((value + 1, -value, value * 2, value * 1000, value // 2))
        else:
            holder[key] = json.loads(json.dumps(other[other_key]))
    elif kind == 3:
        del holder[key]
    elif kind == 4 and isinstance(holder, dict):
        holder[rng.choice(("corner", "enlarged", "pose", "sparse", "matrix", key + "x"))] = (
            rng.choice(([0, 0], True, [[1.0] * 4 for _ in range(4)], {}, 1))
        )
    else:
        copied = json.loads(json.dumps(other[other_key]))
        if isinstance(holder, list):
            holder.append(copied)
        else:
            holder[key] = copied
    return tree


def _value(rng: random.Random) -> Any:
    return copy.deepcopy(rng.choice(_VALUES))


def _gltf(data: bytes, rng: random.Random) -> bytes:
    if not data.startswith(b"glTF"):
        return _json(data, rng)
    (length,) = struct.unpack_from("<I", data, 12)
    return glb(_json(data[20 : 20 + length], rng), data[28 + length :])


def _zip(data: bytes, rng: random.Random) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(made, "w") as new:
        names = old.namelist()
        changed = rng.choice(names)
        for name in names:
            content, kind = old.read(name), rng.randrange(4)
            if name == changed and kind == 0:
                continue
            stored = name
            if name == changed and kind == 1:
                stored = rng.choice(("../a", "/a", "a/../../b", "scene.json/", "x" * 300, "ball"))
            elif name == changed:
                content = _json(content, rng) if name.endswith(".json") else _flipped(content, rng)
            new.writestr(zipfile.ZipInfo(stored), content, rng.choice((0, 8)))
    return made.getvalue()


def _text(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    at, kind = rng.randrange(len(lines)), rng.randrange(4)
    if kind == 0:
        lines.insert(at, rng.choice(_WORDS))
    elif kind == 1:
        words = lines[at].split(b" ")
        words[rng.randrange(len(words))] = rng.choice(_WORDS)
        lines[at] = b" ".join(words)
    elif kind == 2:
        lines.insert(at, rng.choice(lines))
    else:
        del lines[at]
    return b"\n".join(lines)


def _png(data: bytes, rng: random.Random, flip: Flip) -> bytes:
    """One chunk changed, its checksum right."""
    chunks, position = [], 8
    while position + 8 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        body = data[position + 8 : position + 8 + length]
        chunks.append((data[position + 4 : position + 8], body))
        position += 12 + length
    at = rng.randrange(len(chunks))
    kind, body = chunks[at]
    if rng.random() < 0.2:
        chunks.insert(at, rng.choice(chunks))
    else:
        chunks[at] = (kind, flip(body, len(body) + 16))
    return seeds.png(chunks)
