"""glTF files written by hand, byte by byte, so that the reader is not tested against itself."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class GltfBuilder:
    """Collects accessors and images, then writes a ``.glb`` or a ``.gltf`` with its files."""

    def __init__(self) -> None:
        self.data = b""
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
        }

    def view(self, data: bytes, **extra: Any) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.tree["bufferViews"].append({**entry, **extra})
        self.data += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str = "f4", **extra: Any) -> int:
        array = np.asarray(values, dtype="<" + dtype)
        array = array.reshape(len(array), -1)
        entry = {
            "bufferView": self.view(array.tobytes()),
            "componentType": COMPONENTS[dtype],
            "count": len(array),
            "type": TYPES[array.shape[1]],
        }
        self.tree["accessors"].append({**entry, **extra})
        return len(self.tree["accessors"]) - 1

    def image(self, pixels: np.ndarray, uri: str | None = None) -> int:
        """Add an RGB(A) picture, embedded or to lie beside the file; returns its texture."""
        order = [2, 1, 0, 3][: pixels.shape[2]]
        encoded = cv2.imencode(".png", np.ascontiguousarray(pixels[..., order]))[1].tobytes()
        images = self.tree.setdefault("images", [])
        if uri is None:
            images.append({"bufferView": self.view(encoded), "mimeType": "image/png"})
        else:
            images.append({"uri": uri})
        textures = self.tree.setdefault("textures", [])
        textures.append({"source": len(images) - 1})
        return len(textures) - 1

    def material(self, **fields: Any) -> int:
        self.tree.setdefault("materials", []).append(fields)
        return len(self.tree["materials"]) - 1

    def primitive(self, faces: Any, *, index_type: str = "u2", **fields: Any) -> dict[str, Any]:
        attributes = {name: fields.pop(name) for name in list(fields) if name.isupper()}
        entry: dict[str, Any] = {"attributes": attributes, **fields}
        if faces is not None:
            entry["indices"] = self.accessor(np.ravel(faces), index_type)
        return entry

    def node(self, *primitives: dict[str, Any], root: bool = True, **fields: Any) -> int:
        if primitives:
            self.tree["meshes"].append({"primitives": list(primitives)})
            fields["mesh"] = len(self.tree["meshes"]) - 1
        self.tree["nodes"].append(fields)
        index = len(self.tree["nodes"]) - 1
        if root:
            self.tree["scenes"][0]["nodes"].append(index)
        return index

    def write(self, path: Path) -> Path:
        """Write ``.glb``, or ``.gltf`` with ``<name>.bin`` beside it."""
        buffer: dict[str, Any] = {"byteLength": len(self.data)}
        if path.suffix == ".gltf":
            buffer["uri"] = path.with_suffix(".bin").name
            path.with_suffix(".bin").write_bytes(self.data)
            path.write_text(json.dumps({**self.tree, "buffers": [buffer]}))
            return path
        path.write_bytes(glb(json.dumps({**self.tree, "buffers": [buffer]}).encode(), self.data))
        return path


def glb(text: bytes, binary: bytes = b"") -> bytes:
    """A GLB of two chunks."""
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


QUAD = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
QUAD_FACES = np.int32([[0, 1, 2], [0, 2, 3]])
QUAD_UV = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
"""The picture upright on the quad, as seen from +z."""


def box_arrays(sides: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """A box standing on y = 0, centred in x and z, its vertices shared; faces look outwards."""
    x, y, z = sides
    corners = [(i, j, k) for i in (-0.5, 0.5) for j in (0.0, 1.0) for k in (-0.5, 0.5)]
    vertices = np.float32(corners) * np.float32([x, y, z])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.int32([[q[i] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))])


def sphere_arrays(radius: float, rings: int = 180) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and exact normals of a finely tessellated sphere around the origin."""
    theta = np.linspace(0.0, np.pi, rings + 1)
    phi = np.linspace(0.0, 2.0 * np.pi, 2 * rings, endpoint=False)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    normals = np.stack([np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)], axis=-1)
    normals = normals.reshape(-1, 3).astype(np.float32)
    row, column = np.mgrid[:rings, : 2 * rings]
    after = (column + 1) % (2 * rings)
    width = 2 * rings
    a, b = row * width + column, row * width + after
    c, d = a + width, b + width
    faces = np.stack([np.stack([a, b, c], -1), np.stack([b, d, c], -1)], axis=2).reshape(-1, 3)
    return normals * np.float32(radius), faces.astype(np.int32), normals


def obj_files(
    folder: Path, *, material: str = "newmtl red\nKd 0.5 0.25 0.0\nNs 98\n", lines: str = ""
) -> Path:
    """An OBJ box with its material beside it, of which both texts can be given."""
    (folder / "a.mtl").write_text(material)
    vertices, faces = box_arrays((1, 1, 1))
    text = "mtllib a.mtl\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in vertices)
    text += lines + "usemtl red\n" + "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1)
    (folder / "a.obj").write_text(text)
    return folder / "a.obj"


def write_box(
    path: Path, sides: tuple[float, float, float] = (1.0, 1.0, 1.0), **material: Any
) -> Path:
    """A box in one material, without normals or texture coordinates."""
    builder = GltfBuilder()
    vertices, faces = box_arrays(sides)
    fields: dict[str, Any] = {"POSITION": builder.accessor(vertices)}
    if material:
        fields["material"] = builder.material(**material)
    builder.node(builder.primitive(faces, **fields))
    return builder.write(path)
