"""A glTF 2.0 file: its JSON, its buffers and images, and its accessors as arrays.

Read with the standard library and numpy, not through trimesh, which leaves out what a product
shot needs (material variants, texture transforms, second texture coordinates, normalised integers)
and passes over missing textures in silence. Nothing outside the file's own folder is opened.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from spotlight_runtime.errors import ImageFileError, ProductError, UnsafePathError
from spotlight_runtime.imaging.decoding import read_bytes

__all__ = ["GltfFile", "open_gltf", "read_beside"]


_GLB_MAGIC: Final = b"glTF"
_CHUNK_JSON, _CHUNK_BINARY = 0x4E4F534A, 0x004E4942
_COMPONENTS: Final = {
    5120: np.int8,
    5121: np.uint8,
    5122: np.int16,
    5123: np.uint16,
    5125: np.uint32,
    5126: np.float32,
}
MAX_SPARSE: Final = 10_000_000
"""Values of an accessor that has none of its own: as many as the largest model has triangles."""
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_UNDERSTOOD: Final = {
    "EXT_texture_webp",
    "KHR_materials_variants",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
}
"""Extensions a file may require. Those that only refine a look (KHR_materials_*, lights) pass."""
_HARMLESS: Final = ("KHR_materials_", "KHR_lights_")


@dataclass(frozen=True, slots=True)
class GltfFile:
    """An opened glTF file.

    Attributes
    ----------
    path : Path
    tree : dict
        Its JSON.
    buffers : tuple of bytes
    """

    path: Path
    tree: dict[str, Any]
    buffers: tuple[bytes, ...]

    def view(self, index: int) -> bytes:
        """Bytes of a buffer view."""
        view = self.tree["bufferViews"][_row(index)]
        start, length = view.get("byteOffset", 0), view["byteLength"]
        data = self.buffers[_row(view["buffer"])]
        if not 0 <= start <= start + length <= len(data):
            raise ProductError(
                f"{self.path}: buffer view {index} reaches over the end of its buffer "
                f"({start} + {length} of {len(data)} bytes); export the model again"
            )
        return data[start : start + length]

    def image(self, index: int) -> bytes:
        """Bytes of an image file.

        Raises
        ------
        ProductError, UnsafePathError
            If it is missing, or outside the model's folder.
        """
        entry = self.tree["images"][_row(index)]
        if "bufferView" in entry:
            return self.view(entry["bufferView"])
        return _resource(self.path, entry["uri"], "texture")

    def accessor(self, index: int) -> npt.NDArray[Any]:
        """An accessor's values, shape (count, components); normalised integers as floats."""
        entry = self.tree["accessors"][_row(index)]
        kind = np.dtype(_COMPONENTS[entry["componentType"]])
        count, width = _row(entry["count"]), _WIDTHS[entry["type"]]
        if "bufferView" in entry:
            view = self.tree["bufferViews"][_row(entry["bufferView"])]
            stride = view.get("byteStride", kind.itemsize * width)
            data = self.view(entry["bufferView"])
            values = self._strided(data, entry.get("byteOffset", 0), stride, count, width, kind)
        elif "sparse" in entry:
            if count > MAX_SPARSE:
                raise ProductError(
                    f"{self.path}: accessor {index} claims {count} values that are not in the "
                    f"file, more than the limit of {MAX_SPARSE}; export the model again"
                )
            values = np.zeros((count, width), dtype=kind)
        else:
            raise ProductError(
                f"{self.path}: accessor {index} has no data of its own (a compressed mesh?); "
                "export the model without mesh compression"
            )
        if "sparse" in entry:
            values = self._patched(values, entry["sparse"])
        if entry.get("normalized", False) and kind.kind in "iu":
            top = float(2 ** (8 * kind.itemsize - (kind.kind == "i")) - 1)
            return np.maximum(values / top, -1.0).astype(np.float32)
        return values

    def _strided(
        self, data: bytes, start: int, stride: int, count: int, width: int, kind: np.dtype[Any]
    ) -> npt.NDArray[Any]:
        row = kind.itemsize * width
        if not (start >= 0 and row <= stride and start + stride * (count - 1) + row <= len(data)):
            raise ProductError(
                f"{self.path}: an accessor of {count} values reaches over the end of its "
                f"buffer view ({len(data)} bytes); export the model again"
            )
        raw = np.ndarray((count, row), np.uint8, data, start, (stride, 1))
        return np.ascontiguousarray(raw).view(kind.newbyteorder("<"))

    def _patched(self, values: npt.NDArray[Any], sparse: dict[str, Any]) -> npt.NDArray[Any]:
        count, where = _row(sparse["count"]), sparse["indices"]
        kind = np.dtype(_COMPONENTS[where["componentType"]])
        data = self.view(where["bufferView"])
        rows = self._strided(data, where.get("byteOffset", 0), kind.itemsize, count, 1, kind)[:, 0]
        data, start = self.view(sparse["values"]["bufferView"]), sparse["values"]
        width, size = values.shape[1], values.dtype.itemsize * values.shape[1]
        patch = self._strided(data, start.get("byteOffset", 0), size, count, width, values.dtype)
        patched = values.copy()
        patched[rows] = patch
        return patched


def open_gltf(path: Path) -> GltfFile:
    """Open a ``.gltf`` or ``.glb`` file and read its buffers.

    Raises
    ------
    ProductError
        If it is no glTF 2.0 file, needs an extension that is not understood, or misses a file.
    UnsafePathError
        If it names a file outside its folder, or on another machine.
    """
    data = _read(path, "model")
    binary = b""
    if data.startswith(_GLB_MAGIC):
        data, binary = _split_glb(data, path)
    try:
        tree = json.loads(data)
        version = str(tree["asset"]["version"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ProductError(
            f"{path}: expected a glTF 2.0 model, got other content ({type(error).__name__}); "
            "export it as .glb"
        ) from error
    if not version.startswith("2."):
        raise ProductError(f"{path}: expected glTF 2.0, got {version}; export it as glTF 2.0")
    required = tree.get("extensionsRequired", [])
    foreign = [e for e in required if e not in _UNDERSTOOD and not str(e).startswith(_HARMLESS)]
    if foreign:
        raise ProductError(
            f"{path}: the model needs {', '.join(map(str, foreign))}, which is not understood; "
            "export it without (no mesh or texture compression)"
        )
    buffers = tuple(
        _resource(path, entry["uri"], "buffer") if "uri" in entry else binary
        for entry in tree.get("buffers", [])
    )
    return GltfFile(path, tree, buffers)


def read_beside(model: Path, name: str, kind: str) -> bytes:
    """Read a file that a model names, if it lies in the model's folder or below.

    Raises
    ------
    UnsafePathError
        If it lies elsewhere.
    ProductError
        If it is missing.
    """
    folder = model.parent.resolve()
    remote = "://" in name or name.startswith(("//", "\\\\"))
    try:
        target = (folder / name.replace("\\", "/")).resolve()
        inside = target.is_relative_to(folder) and not os.path.isabs(name)
    except (OSError, RuntimeError, ValueError) as error:  # a null byte, a symlink to itself
        raise ProductError(f"{model}: the {kind} {name!r} is no file name: {error}") from error
    if remote or not inside:
        raise UnsafePathError(
            f"{model}: the {kind} {name!r} lies outside the model's folder and is not opened; "
            "copy it beside the model and name it there, or export a self-contained .glb"
        )
    if not os.path.isfile(target):  # unlike Path.is_file, False for impossible names too
        raise ProductError(
            f"{model}: expected the {kind} {name!r} beside the model, found no such file; "
            "copy it there, or export a self-contained .glb"
        )
    return _read(target, kind)


def _resource(model: Path, uri: str, kind: str) -> bytes:
    if not isinstance(uri, str):
        raise ProductError(f"{model}: expected a file name for a {kind}, got {uri!r}")
    if not uri.startswith("data:"):
        return read_beside(model, unquote(uri), kind)
    _, comma, payload = uri.partition(",")
    try:
        return base64.b64decode(payload if comma else "!", validate=True)
    except (binascii.Error, ValueError) as error:
        raise ProductError(
            f"{model}: a {kind} is embedded as damaged base64 ({error}); export the model again"
        ) from error


def _split_glb(data: bytes, path: Path) -> tuple[bytes, bytes]:
    """JSON and binary chunk of a GLB."""
    chunks: dict[int, bytes] = {}
    try:
        _, version, total = struct.unpack_from("<4sII", data)
        position = 12
        while position < min(total, len(data)):
            length, kind = struct.unpack_from("<II", data, position)
            chunks.setdefault(kind, data[position + 8 : position + 8 + length])
            position += 8 + length
    except struct.error:
        version, total = 2, len(data) + 1
    if version != 2 or total > len(data) or _CHUNK_JSON not in chunks:
        raise ProductError(
            f"{path}: expected a whole GLB 2.0 file, got version {version} with {len(data)} of "
            f"{total} bytes; export or download it again"
        )
    return chunks[_CHUNK_JSON], chunks.get(_CHUNK_BINARY, b"")


def _read(path: Path, kind: str) -> bytes:
    try:
        data = read_bytes(path)
    except ImageFileError as error:
        raise ProductError(f"{error} (the {kind} of a product)") from error
    if not data:
        raise ProductError(f"{path}: the {kind} is an empty file; export the model again")
    return data


def _row(value: Any) -> int:
    """An index or count of the JSON; what is none becomes an error that the loader names."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"expected a whole number, got {value!r}")
    return value
