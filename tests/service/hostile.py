"""Uploads nobody should let in, each with what it is and the statuses that say so."""

from __future__ import annotations

import base64
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable

import cv2
import numpy as np

PNG = b"\x89PNG\r\n\x1a\n"
Case = tuple[dict[str, bytes], tuple[int, ...]]


def picture(suffix: str = ".png", size: tuple[int, int] = (64, 96)) -> bytes:
    rng = np.random.default_rng(1)
    pixels = rng.integers(40, 200, (*size, 3), dtype=np.uint8)
    return cv2.imencode(suffix, pixels)[1].tobytes()


def cutout() -> bytes:
    pixels = np.zeros((32, 32, 4), np.uint8)
    pixels[8:28, 10:22] = (60, 90, 200, 255)
    return cv2.imencode(".png", pixels)[1].tobytes()


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_header(width: int, height: int) -> bytes:
    return PNG + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))


def png_bomb(width: int = 4000, height: int = 4000) -> bytes:
    """Sixteen megapixels of nothing in a hundred kilobytes."""
    data = zlib.compress(b"\0" * 48_004_000, 9)
    return png_header(width, height) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def archive(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as made:
        for name, data in files.items():
            made.writestr(zipfile.ZipInfo(name), data, method)
    return buffer.getvalue()


def link(name: str, target: str) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as made:
        entry = zipfile.ZipInfo(name)
        entry.create_system, entry.external_attr = 3, 0o120777 << 16
        made.writestr(entry, target)
        made.writestr("scene.json", "{}")
    return buffer.getvalue()


def lying_size(good: bytes) -> bytes:
    """An archive whose directory says that every file has one byte."""
    data = bytearray(good)
    place = data.find(b"PK\x01\x02")
    while place >= 0:
        data[place + 24 : place + 28] = struct.pack("<I", 1)
        place = data.find(b"PK\x01\x02", place + 4)
    return bytes(data)


def scene_json(**changes: object) -> bytes:
    record = {
        "version": 1,
        "width": 96,
        "height": 64,
        "background": {"image": {"file": "p.png"}, "albedo": {"file": "p.png"}},
        "object": {"mask": {"file": "p.png"}, "albedo": {"file": "p.png"}},
    }
    return json.dumps({**record, **changes}).encode()


def gltf(uri: str) -> bytes:
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": uri, "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    return json.dumps(tree).encode()


def photo(data: bytes, *statuses: int) -> Case:
    return {"photo": data, "object": cutout()}, statuses


def thing(data: bytes, *statuses: int) -> Case:
    return {"photo": picture(".jpg"), "object": data}, statuses


def bundle(data: bytes, *statuses: int) -> Case:
    return {"bundle": data}, statuses


SVG = b'<svg xmlns="http://www.w3.org/2000/svg"><script>alert(1)</script></svg>'
HTML = b"<!DOCTYPE html><html><script>alert(1)</script></html>"
EXR_BOMB = (
    b"\x76\x2f\x31\x01\x02\0\0\0dataWindow\0box2i\0"
    + struct.pack("<i4i", 16, 0, 0, 99_999, 99_999)
    + b"\0"
)
WEBP_BOMB = b"RIFF\x20\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0\xff\xff\xff\xff\xff\xff" + b"\0" * 16
JPEG = picture(".jpg")
GOOD = {"scene.json": scene_json(), "p.png": picture()}

CASES: dict[str, Callable[[], Case]] = {
    "an empty photograph": lambda: photo(b"", 415),
    "a text as photograph": lambda: photo(b"hello" * 100, 415),
    "an SVG as photograph": lambda: photo(SVG, 415),
    "an SVG with an XML head": lambda: photo(b'<?xml version="1.0"?>' + SVG, 415),
    "a web page as photograph": lambda: photo(HTML, 415),
    "a PDF as photograph": lambda: photo(b"%PDF-1.7\n" + b"x" * 200, 415),
    "a GIF": lambda: photo(b"GIF89a" + b"\0" * 100, 415),
    "a BMP": lambda: photo(picture(".bmp"), 415),
    "a TIFF": lambda: photo(picture(".tiff"), 415),
    "a program": lambda: photo(b"\x7fELF\x02\x01\x01" + b"\0" * 200, 415),
    "a zip as photograph": lambda: photo(archive(GOOD), 415),
    "a PNG's signature alone": lambda: photo(PNG, 415),
    "a PNG with half a header": lambda: photo(png_header(10, 10)[:20], 415),
    "a PNG of no pixels": lambda: photo(png_header(0, 0) + chunk(b"IEND", b""), 415),
    "a PNG of four gigapixels": lambda: photo(png_header(65_535, 65_535), 413),
    "a PNG of 2^31 pixels across": lambda: photo(png_header(2**31 - 1, 1), 413),
    "a PNG without data": lambda: photo(png_header(64, 64) + chunk(b"IEND", b""), 422),
    "a truncated PNG": lambda: photo(picture()[:-200], 422),
    "a PNG bomb": lambda: photo(png_bomb(), 413),
    "a truncated JPEG": lambda: photo(JPEG[: len(JPEG) // 2], 422),
    "a JPEG's first bytes": lambda: photo(b"\xff\xd8\xff\xe0", 415),
    "a JPEG that is an archive": lambda: photo(JPEG + archive(GOOD), 415),
    "a PNG that is an archive": lambda: photo(picture() + archive(GOOD), 415),
    "a JPEG that is a web page": lambda: photo(JPEG + HTML, 415),
    "a PNG with a script in its text": lambda: photo(
        picture()[:33] + chunk(b"tEXt", b"Note\0<script>alert(1)</script>") + picture()[33:], 415
    ),
    "a JPEG that is PHP": lambda: photo(JPEG + b"<?php system($_GET[0]); ?>", 415),
    "a JPEG that is a PDF": lambda: photo(JPEG + b"\n%PDF-1.4\n", 415),
    "an EXR of ten gigapixels": lambda: photo(EXR_BOMB, 413),
    "a WebP of 2^48 pixels": lambda: photo(WEBP_BOMB, 413),
    "an HDR of a terapixel": lambda: photo(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 999999 +X 999999\n", 413
    ),
    "an HDR that ends at once": lambda: photo(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 64 +X 64\n", 422
    ),
    "a photograph of one pixel": lambda: photo(picture(size=(1, 1)), 422),
    "an object that is text": lambda: thing(b"just words", 415),
    "an object that is a web page": lambda: thing(HTML, 415),
    "an object that is an SVG": lambda: thing(SVG, 415),
    "a picture without transparency": lambda: thing(picture(), 422),
    "a cut-out of nothing": lambda: thing(
        cv2.imencode(".png", np.zeros((20, 20, 4), np.uint8))[1].tobytes(), 422
    ),
    "a GLB's first bytes": lambda: thing(b"glTF\x02\0\0\0\x0c\0\0\0", 422),
    "a GLB of four gigabytes, it says": lambda: thing(
        b"glTF" + struct.pack("<II", 2, 2**32 - 1) + struct.pack("<II", 2**32 - 16, 0x4E4F534A), 422
    ),
    "a glTF that wants /etc/passwd": lambda: thing(gltf("/etc/passwd"), 422),
    "a glTF that climbs": lambda: thing(gltf("../../../../etc/passwd"), 422),
    "a glTF that fetches": lambda: thing(gltf("http://169.254.169.254/latest/"), 422),
    "a glTF that opens a file: address": lambda: thing(gltf("file:///etc/passwd"), 422),
    "a glTF with half its buffer": lambda: thing(
        gltf("data:application/octet-stream;base64," + base64.b64encode(b"\0" * 9).decode()), 422
    ),
    "a glTF nested a hundred thousand deep": lambda: thing(b'{"asset":' + b"[" * 100_000, 415),
    "an OBJ with a library elsewhere": lambda: thing(
        b"mtllib /etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 422
    ),
    "an OBJ that climbs": lambda: thing(
        b"mtllib ../../secret.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 422
    ),
    "an OBJ without faces": lambda: thing(b"v 0 0 0\nv 1 0 0\n", 422),
    "an OBJ of infinities": lambda: thing(b"v inf 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n", 422),
    "a bundle that is no zip": lambda: bundle(b"PK\x03\x04 and so on", 415),
    "a bundle that is a picture": lambda: bundle(picture(), 415),
    "an empty zip": lambda: bundle(archive({}), 422),
    "a truncated zip": lambda: bundle(archive(GOOD)[:-30], 415),
    "a zip that slips": lambda: bundle(archive({**GOOD, "../../evil.png": picture()}), 422),
    "a zip with an absolute name": lambda: bundle(archive({**GOOD, "/tmp/evil.png": b""}), 422),
    "a zip with a Windows path": lambda: bundle(archive({**GOOD, "C:\\evil.png": b""}), 422),
    "a zip with a backslash": lambda: bundle(archive({**GOOD, "..\\evil.png": b""}), 422),
    "a zip with a link": lambda: bundle(link("background.png", "/etc/passwd"), 422),
    "a zip of a hundred files": lambda: bundle(
        archive({**GOOD, **{f"{i}.png": b"" for i in range(100)}}), 413
    ),
    "a zip bomb": lambda: bundle(archive({**GOOD, "bomb.json": b"\0" * 21_000_000}), 413),
    "a zip that lies about its sizes": lambda: bundle(lying_size(archive(GOOD)), 413, 422),
    "a zip with a program": lambda: bundle(archive({**GOOD, "run.py": b"import os"}), 415),
    "a zip in a zip": lambda: bundle(archive({**GOOD, "more.zip": archive(GOOD)}), 415),
    "a zip with an SVG called PNG": lambda: bundle(archive({**GOOD, "p.png": SVG}), 415),
    "a zip with a JPEG called PNG": lambda: bundle(archive({**GOOD, "p.png": JPEG}), 415),
    "a zip with a picture bomb": lambda: bundle(
        archive({**GOOD, "p.png": png_header(60_000, 60_000)}), 413
    ),
    "a zip with a web page for scene.json": lambda: bundle(
        archive({**GOOD, "scene.json": HTML}), 415
    ),
    "a zip without scene.json": lambda: bundle(archive({"p.png": picture()}), 422),
    "a scene that names a file outside": lambda: bundle(
        archive(
            {
                **GOOD,
                "scene.json": scene_json(
                    background={
                        "image": {"file": "../../../etc/passwd"},
                        "albedo": {"file": "p.png"},
                    }
                ),
            }
        ),
        422,
    ),
    "a scene of another size than its maps": lambda: bundle(
        archive({**GOOD, "scene.json": scene_json(width=100)}), 422
    ),
    "a scene with NaN": lambda: bundle(archive({**GOOD, "scene.json": b'{"version": NaN}'}), 422),
    "a scene nested a hundred thousand deep": lambda: bundle(
        archive({**GOOD, "scene.json": b"[" * 100_000}), 422
    ),
    "a pickle for a mesh": lambda: bundle(
        archive(
            {
                **GOOD,
                "mesh.npz": archive({"vertices.npy": b"\x80\x04cos\nsystem\n"}),
                "scene.json": scene_json(object_geometry={"file": "mesh.npz"}),
            }
        ),
        422,
    ),
    "a mesh bomb": lambda: bundle(
        archive(
            {
                **GOOD,
                "mesh.npz": archive({"vertices.npy": b"\0" * 21_000_000}),
                "scene.json": scene_json(object_geometry={"file": "mesh.npz"}),
            }
        ),
        413,
    ),
}
"""By what they are. Statuses: 413 too large, 415 not one of the formats, 422 not possible."""
