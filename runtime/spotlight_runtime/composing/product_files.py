"""Reading products: glTF and GLB with this package's own reader, OBJ through trimesh."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from spotlight_runtime.composing.gltf import read_beside
from spotlight_runtime.composing.gltf_scene import read_gltf
from spotlight_runtime.composing.materials import Material, make_texture
from spotlight_runtime.composing.product import Piece, Product, assemble
from spotlight_runtime.errors import MissingExtraError, ProductError, SpotLightError
from spotlight_runtime.imaging.headers import check_header

__all__ = ["PRODUCT_SUFFIXES", "load_product", "require_scene_extra"]


PRODUCT_SUFFIXES: Final = (".glb", ".gltf", ".obj")
_TEXTURES: Final = {".png", ".jpg", ".jpeg", ".webp"}
_PHONG_DEFAULT: Final = 32.0
"""Shininess of an OBJ material that does not say; a satin surface."""
_OBJ_ADVICE: Final = "name an existing file in the model or its .mtl, or export it as .glb"


def require_scene_extra() -> None:
    """Raise unless what products are read and seen with is installed.

    Raises
    ------
    MissingExtraError
        Naming the pip command.
    """
    missing = [m for m in ("trimesh", "embreex", "PIL") if importlib.util.find_spec(m) is None]
    if missing:
        raise MissingExtraError(
            f"3-D objects need {', '.join(missing)}: pip install 'spotlight-relight[scene]', "
            "or give a cut-out picture of the object instead"
        )


def load_product(path: str | Path, variant: str | None = None) -> Product:
    """Read a 3-D model.

    Parameters
    ----------
    path : str or Path
        ``.glb``, ``.gltf`` or ``.obj``, y up, in metres.
    variant : str, optional
        Which of a glTF's material variants.

    Raises
    ------
    ProductError
        If it is missing, no such model, empty, or not finite.
    UnsafePathError
        If it names a file outside its folder.
    MissingExtraError
        If the extra ``scene`` is not installed.
    """
    path = Path(path)
    require_scene_extra()
    if path.suffix.lower() not in PRODUCT_SUFFIXES:
        raise ProductError(
            f"{path}: expected a model ({', '.join(PRODUCT_SUFFIXES)}), got {path.suffix!r}; "
            "export it as .glb"
        )
    if not os.path.isfile(path):
        raise ProductError(f"{path}: expected a model, found no such file; check the path")
    if path.suffix.lower() != ".obj":
        return assemble(read_gltf(path, variant), path.stem)
    if variant is not None:
        raise ProductError(f"{path}: an OBJ has no variants; leave the variant out")
    return assemble(_read_obj(path), path.stem)


class _Beside:
    """What trimesh asks for an OBJ's companions; remembers what it could not have.

    trimesh passes over a missing texture in silence, so the reader looks here afterwards.
    """

    def __init__(self, model: Path) -> None:
        self._model = model
        self.problems: list[Exception] = []

    def get(self, name: str) -> bytes:
        """Contents of a file beside the model."""
        name = name.strip()
        kind = "texture" if Path(name).suffix.lower() in _TEXTURES else "material file"
        try:
            data = read_beside(self._model, name, kind)
            if kind == "texture":
                check_header(data, f"{self._model}: texture {name!r}")
        except Exception as error:
            self.problems.append(error)
            raise
        return data

    __getitem__ = get


def _read_obj(path: Path) -> list[Piece]:
    import trimesh

    beside = _Beside(path)
    try:
        with path.open("rb") as file:
            loaded = trimesh.load_scene(file, file_type="obj", resolver=beside)
        # An OBJ has no scene graph, so its geometries are in place as they are.
        meshes = [mesh for mesh in loaded.geometry.values() if isinstance(mesh, trimesh.Trimesh)]
        pieces = [_obj_piece(mesh, path) for mesh in meshes if len(mesh.faces)]
    except SpotLightError:
        raise
    except Exception as error:  # trimesh's parsers raise whatever they stumble over
        if beside.problems:
            raise beside.problems[0] from error
        raise ProductError(
            f"{path}: expected an OBJ model, got other content ({type(error).__name__}: {error}); "
            "export it again, or as .glb"
        ) from error
    if beside.problems:
        raise beside.problems[0]
    return pieces


def _obj_piece(mesh: Any, path: Path) -> Piece:
    count = len(mesh.vertices)
    if np.shape(mesh.vertices) != (count, 3):
        raise ValueError(f"expected vertices of 3 numbers, got shape {np.shape(mesh.vertices)}")
    uv = np.zeros((count, 2, 2), dtype=np.float32)
    given = getattr(mesh.visual, "uv", None)
    if given is not None and len(given) == count:
        uv[:, 0] = np.stack([given[:, 0], 1.0 - given[:, 1]], axis=1)
    colours = None
    if mesh.visual.kind == "vertex":
        colours = np.asarray(mesh.visual.vertex_colors, dtype=np.float32) / np.float32(255.0)
    has_normals = "vertex_normals" in mesh._cache.cache
    return Piece(
        vertices=np.asarray(mesh.vertices, dtype=np.float32),
        faces=np.asarray(mesh.faces, dtype=np.int32),
        material=_obj_material(getattr(mesh.visual, "material", None), path),
        normals=np.asarray(mesh.vertex_normals, dtype=np.float32) if has_normals else None,
        uv=uv,
        colours=colours,
    )


def _obj_material(source: Any, path: Path) -> Material:
    """Translate a Phong material: Kd and map_Kd are kept, the exponent becomes a roughness."""
    if source is None or not hasattr(source, "diffuse"):
        return Material()
    # trimesh keeps the file's own values, by lower-case name, beside an 8-bit colour.
    stated = {name: np.ravel(value) for name, value in source.kwargs.items()}
    red, green, blue = (float(value) for value in stated.get("kd", source.diffuse[:3] / 255.0))
    alpha = float(stated.get("d", [1.0])[0])
    image = getattr(source, "image", None)
    texture = None
    if image is not None:
        try:
            pixels = np.asarray(image.convert("RGBA" if "A" in image.getbands() else "RGB"))
        except Exception as error:  # Pillow decodes late and raises of every kind
            raise ProductError(
                f"{path}: a texture cannot be decoded ({error}); {_OBJ_ADVICE}"
            ) from error
        texture = make_texture(pixels, colour=True)
        if max(red, green, blue) == 0.0:  # some exporters leave Kd black beside a texture
            red = green = blue = 1.0
    shininess = float(stated.get("ns", [_PHONG_DEFAULT])[0])
    return Material(
        base_colour=(red, green, blue, alpha),
        roughness=float(np.sqrt(2.0 / (max(shininess, 0.0) + 2.0))),
        base_texture=texture,
        alpha="opaque" if alpha == 1.0 else "blend",
    )
