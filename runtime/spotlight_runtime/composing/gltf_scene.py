"""From a glTF file's scene graph to pieces of a product, each with its material."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing import product
from spotlight_runtime.composing.gltf import GltfFile, open_gltf
from spotlight_runtime.composing.materials import (
    Material,
    Texture,
    Wrap,
    decode_texture,
    make_texture,
)
from spotlight_runtime.composing.product import Piece
from spotlight_runtime.errors import InvalidInputError, ProductError

__all__ = ["gltf_variants", "read_gltf"]


MAX_TEXELS: Final = 1 << 28
"""Of all images: sixty-four of the largest that are kept, two gigabytes."""

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_WRAPS: Final[dict[int, Wrap]] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_TRANSFORM: Final = "KHR_texture_transform"
_VARIANTS: Final = "KHR_materials_variants"
_SPECULAR: Final = "KHR_materials_pbrSpecularGlossiness"


def read_gltf(path: Path, variant: str | None = None) -> list[Piece]:
    """Read the triangles of a glTF file's scene, in its world axes (y up, metres).

    Parameters
    ----------
    path : Path
    variant : str, optional
        Which of the file's material variants; its default materials if not given.

    Raises
    ------
    ProductError
        If the file is malformed, or a file it names is missing.
    InvalidInputError
        If there is no such variant.
    """
    try:
        file = open_gltf(path)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused later
            return list(_Reader(file, _variant_index(file, variant)).pieces())
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        # What is wrong with the JSON shows where it is used; errors of the package pass.
        if type(error).__module__.startswith("spotlight_runtime"):
            raise
        raise ProductError(
            f"{path}: malformed glTF ({type(error).__name__}: {error}); export the model again"
        ) from error


def gltf_variants(tree: dict[str, Any]) -> list[str]:
    """Names of a file's material variants, in its order."""
    listed = tree.get("extensions", {}).get(_VARIANTS, {}).get("variants", [])
    return [str(entry.get("name", i)) for i, entry in enumerate(listed)]


def _variant_index(file: GltfFile, variant: str | None) -> int | None:
    if variant is None:
        return None
    names = gltf_variants(file.tree)
    folded = [name.casefold() for name in names]
    if variant.casefold() not in folded:
        raise InvalidInputError(
            f"variant: expected one of {', '.join(names) or 'none, as the model has no variants'}, "
            f"got {variant!r}"
        )
    return folded.index(variant.casefold())


class _Reader:
    """Walks one file; materials and images are read once, when first used."""

    def __init__(self, file: GltfFile, variant: int | None) -> None:
        self._file = file
        self._variant = variant
        self._pixels: dict[int, npt.NDArray[Any]] = {}
        self._textures: dict[tuple[int, bool, tuple[Wrap, Wrap]], Texture] = {}
        self._texels = 0
        self._materials: dict[int | None, Material] = {None: Material(roughness=1.0)}

    def pieces(self) -> Iterator[Piece]:
        tree = self._file.tree
        corners = 0
        for node, matrix in self._nodes():
            if "mesh" not in node:
                continue
            for primitive in tree["meshes"][node["mesh"]]["primitives"]:
                mode = primitive.get("mode", _TRIANGLES)
                if mode in (_TRIANGLES, _STRIP, _FAN) and "POSITION" in primitive["attributes"]:
                    piece = self._piece(primitive, mode, matrix)
                    # A small file may show its mesh a million times.
                    corners += max(3 * len(piece.faces), len(piece.vertices))
                    if corners > 3 * product.MAX_TRIANGLES:
                        raise ProductError(
                            f"{self._file.path}: expected at most {product.MAX_TRIANGLES} "
                            f"triangles, got {corners // 3}; decimate the model first"
                        )
                    yield piece

    def _nodes(self) -> Iterator[tuple[dict[str, Any], npt.NDArray[np.float64]]]:
        """Nodes of the scene with their world matrices."""
        tree = self._file.tree
        nodes = tree.get("nodes", [])
        if "scenes" in tree:
            roots = tree["scenes"][tree.get("scene", 0)].get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [i for i in range(len(nodes)) if i not in children]
        waiting = [(root, np.eye(4)) for root in reversed(roots)]
        seen: set[int] = set()
        while waiting:
            index, parent = waiting.pop()
            if index in seen:  # forty nodes that share their children are a million million
                raise ValueError(f"node {index} has two parents, or the nodes form a circle")
            seen.add(index)
            matrix = parent @ _local_matrix(nodes[index])
            yield nodes[index], matrix
            below = nodes[index].get("children", [])
            waiting += [(child, matrix) for child in reversed(below)]

    def _piece(
        self, primitive: dict[str, Any], mode: int, matrix: npt.NDArray[np.float64]
    ) -> Piece:
        attributes = {
            name: self._file.accessor(index)
            for name, index in primitive["attributes"].items()
            if name in ("POSITION", "NORMAL", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0")
        }
        points = attributes["POSITION"].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        count = len(points)
        if any(len(values) != count for values in attributes.values()):
            raise ValueError("the attributes of a primitive differ in length")
        order = np.arange(count)
        if "indices" in primitive:
            order = self._file.accessor(primitive["indices"])[:, 0]
            if order.dtype.kind != "u":
                raise ValueError(f"expected indices as unsigned whole numbers, got {order.dtype}")
            order = order.astype(np.int64)
        normals = attributes.get("NORMAL")
        if normals is not None:
            # The inverse transpose, up to a factor and for singular matrices too.
            normals = normals.astype(np.float64) @ _cofactors(matrix[:3, :3]).T
        uv = np.zeros((count, 2, 2), dtype=np.float32)
        for i in (0, 1):
            if f"TEXCOORD_{i}" in attributes:
                uv[:, i] = attributes[f"TEXCOORD_{i}"]
        return Piece(
            vertices=points.astype(np.float32),
            faces=_triangles(order, mode),
            material=self._material(self._material_index(primitive)),
            normals=None if normals is None else normals.astype(np.float32),
            uv=uv,
            colours=_colours(attributes.get("COLOR_0")),
        )

    def _material_index(self, primitive: dict[str, Any]) -> int | None:
        extension = primitive.get("extensions", {}).get(_VARIANTS, {})
        for mapping in extension.get("mappings", []):
            if self._variant is not None and self._variant in mapping["variants"]:
                return int(mapping["material"])
        return primitive.get("material")

    def _material(self, index: int | None) -> Material:
        if index not in self._materials:
            entry = self._file.tree["materials"][index]
            pbr = entry.get("pbrMetallicRoughness", {})
            base, factor = pbr.get("baseColorTexture"), pbr.get("baseColorFactor", [1.0] * 4)
            surface = pbr.get("metallicRoughnessTexture")
            roughness, metallic = pbr.get("roughnessFactor", 1.0), pbr.get("metallicFactor", 1.0)
            old = entry.get("extensions", {}).get(_SPECULAR)
            if old is not None and not pbr:
                base, factor = old.get("diffuseTexture"), old.get("diffuseFactor", [1.0] * 4)
                surface, metallic = None, 0.0
                roughness = 1.0 - old.get("glossinessFactor", 1.0)
            bump = entry.get("normalTexture")
            red, green, blue, alpha = (float(value) for value in factor)
            self._materials[index] = Material(
                base_colour=(red, green, blue, alpha),
                roughness=float(roughness),
                metallic=float(metallic),
                base_texture=self._texture(base, colour=True),
                surface_texture=self._texture(surface, colour=False),
                normal_texture=self._texture(bump, colour=False),
                normal_scale=float((bump or {}).get("scale", 1.0)),
                alpha=_ALPHA_MODES[entry.get("alphaMode", "OPAQUE")],
                alpha_cutoff=float(entry.get("alphaCutoff", 0.5)),
            )
        return self._materials[index]

    def _texture(self, info: dict[str, Any] | None, *, colour: bool) -> Texture | None:
        if info is None:
            return None
        tree = self._file.tree
        entry = tree["textures"][info["index"]]
        webp = entry.get("extensions", {}).get("EXT_texture_webp", {})
        source = webp.get("source", entry.get("source"))
        if source is None:
            raise ProductError(
                f"{self._file.path}: a texture comes only in a compressed format that is not "
                "understood; export the model with PNG or JPEG textures"
            )
        if source not in self._pixels:
            name = tree["images"][source].get("uri", f"image {source}")
            shown = name if not name.startswith("data:") else f"image {source}"
            data = self._file.image(source)
            pixels = decode_texture(data, f"{self._file.path}: texture {shown!r}")
            self._texels += pixels.shape[0] * pixels.shape[1]
            if self._texels > MAX_TEXELS:
                raise ProductError(
                    f"{self._file.path}: expected textures of at most {MAX_TEXELS >> 20} "
                    "megapixels in all, got more; shrink them first"
                )
            self._pixels[source] = pixels
        sampler = tree["samplers"][entry["sampler"]] if "sampler" in entry else {}
        wrap = (_WRAPS[sampler.get("wrapS", 10497)], _WRAPS[sampler.get("wrapT", 10497)])
        change = info.get("extensions", {}).get(_TRANSFORM, {})
        uv_set = change.get("texCoord", info.get("texCoord", 0))
        if uv_set not in (0, 1):
            raise ValueError(f"texture coordinates {uv_set} are not read, only 0 and 1")
        key = (source, colour, wrap)
        if key not in self._textures:  # materials by the hundred may share an image
            pixels = self._pixels[source]
            self._textures[key] = make_texture(pixels, colour=colour, wrap=wrap)
        return replace(self._textures[key], transform=_uv_matrix(change), uv_set=uv_set)


_ALPHA_MODES: Final[dict[str, Any]] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}


def _uv_matrix(change: dict[str, Any]) -> FloatArray:
    """Translation · rotation · scale of KHR_texture_transform."""
    angle = float(change.get("rotation", 0.0))
    (x, y), (across, down) = change.get("offset", (0.0, 0.0)), change.get("scale", (1.0, 1.0))
    cos, sin = np.cos(angle), np.sin(angle)
    rows = [[cos * across, sin * down, x], [-sin * across, cos * down, y]]
    return np.array(rows, dtype=np.float32)


def _local_matrix(node: dict[str, Any]) -> npt.NDArray[np.float64]:
    if "matrix" in node:
        return np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = (float(value) for value in node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.asarray(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _cofactors(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    a, b, c = matrix
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])


def _triangles(order: npt.NDArray[np.int64], mode: int) -> npt.NDArray[np.int32]:
    if mode == _TRIANGLES:
        faces = order[: len(order) // 3 * 3].reshape(-1, 3)
    elif mode == _STRIP:
        faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        faces[1::2] = faces[1::2, ::-1]
    else:
        faces = np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=1)
    return faces.astype(np.int32)


def _colours(values: npt.NDArray[Any] | None) -> FloatArray | None:
    """Linear RGBA of COLOR_0, which may lack alpha."""
    if values is None:
        return None
    colours = np.ones((len(values), 4), dtype=np.float32)
    colours[:, : values.shape[1]] = values
    return colours
