"""What the fuzzers start from: one small file of every kind the runtime reads or comes with."""

from __future__ import annotations

import json
import shutil
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from support.models import QUAD, QUAD_FACES, QUAD_UV, GltfBuilder, write_box
from support.onnx_backbone import write_backbone
from support.pictures import exif, jpeg_with_exif
from support.scenes import make_scene

from spotlight_runtime import write_image
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.geometry.mesh_files import write_mesh
from spotlight_runtime.imaging.images import write_exr_layers

__all__ = ["SIZE", "gltf_files", "images", "manifests", "obj_files", "scenes", "small_mesh"]

SIZE = (8, 12)
"""Of the pictures; the smaller, the more executions a second."""
RUNTIME = Path(__file__).parents[2] / "runtime/spotlight_runtime"
TRIANGLES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"


def small_mesh() -> ObjectMesh:
    vertices = np.float32([[0, 0, -2], [1, 0, -2], [0, 1, -2], [0, 0, -3]])
    return ObjectMesh(vertices, np.int32([[0, 1, 2], [0, 1, 3]]))


def write_scene(folder: Path) -> Path:
    """A bundle with all that one may hold."""
    make_scene(*SIZE).save(folder)
    write_mesh(folder / "object_mesh.npz", small_mesh())
    (folder / "mesh.obj").write_text(TRIANGLES + "f 1 2 3\nf 1 2 4\n")
    write_image(folder / "part.png", np.full((3, 4), 0.5, np.float32))
    write_image(folder / "small.png", np.full((4, 6, 3), 0.5, np.float32))
    return folder


def scenes(folder: Path) -> Iterator[bytes]:
    """``scene.json`` of a bundle with everything, and of the scenes of the demo."""
    document = json.loads((folder / "scene.json").read_text())
    yield json.dumps(document).encode()
    document["object_geometry"] = {"file": "object_mesh.npz", "pose": np.eye(4).tolist()}
    document["ground"] = {"normal": [0.0, 0.8, 0.6], "offset": -1.5}
    document["object"]["mask"] = {"file": "part.png", "corner": [2, 3], "scale": 0.5}
    document["background"]["albedo"] = {"file": "small.png", "enlarged": True, "encoding": "srgb"}
    yield json.dumps(document).encode()
    document["object_geometry"] = {"file": "mesh.obj"}
    document["background"]["normal"]["encoding"] = "normal"
    document["background"]["depth"] = {"file": "part.png", "enlarged": True, "scale": 10}
    yield json.dumps(document).encode()
    for demo in sorted((RUNTIME / "demo").glob("*/scene.json")):
        document = json.loads(demo.read_text())
        yield json.dumps(document | {"height": SIZE[0], "width": SIZE[1]}).encode()


def zipped(folder: Path) -> Iterator[bytes]:
    """The bundle as a zip, of its files and of its folder, stored and deflated."""
    for prefix, kind in (("", zipfile.ZIP_STORED), ("ball/", zipfile.ZIP_DEFLATED)):
        path = folder.with_suffix(".zip")
        with zipfile.ZipFile(path, "w", kind) as archive:
            for file in sorted(folder.iterdir()):
                archive.write(file, prefix + file.name)
        yield path.read_bytes()


def images(folder: Path) -> Iterator[bytes]:
    """Every format, depth and number of channels."""
    rng = np.random.default_rng(0)
    colour = rng.random((*SIZE, 3), dtype=np.float32)
    grey, rgba = colour[..., 0], np.concatenate([colour, colour[..., :1]], axis=2)
    for suffix in (".png", ".jpg", ".webp", ".hdr", ".exr"):
        for pixels in (grey, colour) if suffix in (".png", ".exr") else (colour,):
            write_image(folder / f"a{suffix}", pixels, bits=16)
            yield (folder / f"a{suffix}").read_bytes()
    write_image(folder / "a.png", rgba)
    yield (folder / "a.png").read_bytes()
    large = np.zeros((40, 48, 4), np.float32)  # as large as a photograph must be
    large[8:30, 8:30] = 0.7
    for suffix in (".png", ".webp"):
        write_image(folder / f"b{suffix}", large)
        yield (folder / f"b{suffix}").read_bytes()
    levels = (large[..., :3] * 255).astype(np.uint8)
    yield jpeg_with_exif(levels, exif(6, 28))
    yield jpeg_with_exif(levels, exif(3, None, ">"))
    for flags in ([cv2.IMWRITE_WEBP_QUALITY, 101], [cv2.IMWRITE_WEBP_QUALITY, 50]):
        yield cv2.imencode(".webp", levels, flags)[1].tobytes()
    # Adam7, palettes and text, which OpenCV does not write.
    header = struct.pack(">IIBBBBB", 4, 2, 8, 3, 0, 0, 0)
    rows = zlib.compress(b"\0\0\1\2\3" * 2)
    chunks = [(b"IHDR", header), (b"PLTE", bytes(range(12))), (b"tEXt", b"a\0b"), (b"IDAT", rows)]
    yield png(chunks)


def png(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """A PNG of these chunks, their checksums right."""
    data = b"\x89PNG\r\n\x1a\n"
    for kind, body in [*chunks, (b"IEND", b"")]:
        data += struct.pack(">I", len(body)) + kind + body
        data += struct.pack(">I", zlib.crc32(kind + body))
    return data


def exr_files(folder: Path) -> Iterator[bytes]:
    """A published scene's layers, one layer, half floats, integers, tiles and two parts."""
    path = folder / "a.exr"
    scene = make_scene(*SIZE)
    mask = scene.object_mask

    def scalar(value: np.ndarray) -> np.ndarray:
        return np.stack([value, value, value, mask], axis=-1).astype(np.float16)

    write_exr_layers(
        path,
        {
            "background": scene.background,
            "albedo": scene.object_maps.albedo,
            "mask": scalar(mask),
            "normals": scene.object_maps.normal,
            "depth": scalar(scene.object_maps.depth),
            "footprint_depth": scalar(scene.footprint_depth),
            "composite": scene.truth,
        },
    )
    yield path.read_bytes()
    write_exr_layers(path, {"": scene.background})
    yield path.read_bytes()
    plane = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE)
    flat = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    for kind in (np.uint32, np.float16):
        OpenEXR.File(dict(flat), {"V": plane.astype(kind)}).write(str(path))
        yield path.read_bytes()
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 4
    tiled = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.tiledimage, "tiles": tiles}
    OpenEXR.File(tiled, {"RGB": scene.background}).write(str(path))
    yield path.read_bytes()
    parts = [
        OpenEXR.Part({**flat, "name": name}, {f"{name}.V": plane.astype(np.float32)}, name)
        for name in ("albedo", "mask")
    ]
    OpenEXR.File(parts).write(str(path))
    yield path.read_bytes()


def textured() -> GltfBuilder:
    """A quad with all the reader understands."""
    builder = GltfBuilder()
    picture = np.full((4, 4, 4), 120, np.uint8)
    textures = [builder.image(picture, "t.png"), builder.image(picture)]
    transform = {"offset": [0.1, 0], "scale": [2, 1], "rotation": 0.3, "texCoord": 0}
    material = builder.material(
        pbrMetallicRoughness={
            "baseColorTexture": {
                "index": textures[0],
                "extensions": {"KHR_texture_transform": transform},
            },
            "metallicRoughnessTexture": {"index": textures[1]},
            "baseColorFactor": [1, 0.5, 0.2, 0.9],
            "roughnessFactor": 0.4,
            "metallicFactor": 0.1,
        },
        normalTexture={"index": textures[1], "scale": 0.7},
        alphaMode="MASK",
        alphaCutoff=0.4,
    )
    builder.tree["samplers"] = [{"wrapS": 33071, "wrapT": 33648}]
    builder.tree["textures"][0]["sampler"] = 0
    builder.tree["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "red"}]}}
    quad = builder.primitive(
        QUAD_FACES,
        POSITION=builder.accessor(QUAD),
        NORMAL=builder.accessor(np.tile(np.float32([0, 0, 1]), (4, 1))),
        TEXCOORD_0=builder.accessor(QUAD_UV),
        COLOR_0=builder.accessor(np.full((4, 4), 200), "u1", normalized=True),
        material=material,
    )
    quad["extensions"] = {
        "KHR_materials_variants": {"mappings": [{"material": material, "variants": [0]}]}
    }
    child = builder.node(quad, root=False, rotation=[0, 0.7, 0, 0.7], scale=[1, 2, 1])
    builder.node(children=[child], translation=[0, 1, 0])
    patch = builder.view(np.float32([[0, 0, 1]]).tobytes())
    rows = builder.view(np.uint16([2]).tobytes())
    sparse = {
        "count": 1,
        "indices": {"bufferView": rows, "componentType": 5123},
        "values": {"bufferView": patch},
    }
    builder.node(builder.primitive([0, 1, 2], POSITION=builder.accessor(QUAD, sparse=sparse)))
    for mode in (5, 6):
        builder.node(builder.primitive(None, mode=mode, POSITION=builder.accessor(QUAD)))
    return builder


def gltf_files(folder: Path) -> Iterator[bytes]:
    """JSON and binary; what the JSON names lies in the folder."""
    cv2.imwrite(str(folder / "t.png"), np.full((4, 4, 3), 99, np.uint8))
    yield textured().write(folder / "quad.gltf").read_bytes()
    yield textured().write(folder / "quad2.glb").read_bytes()
    yield write_box(folder / "box.glb", doubleSided=True).read_bytes()
    old = {"diffuseFactor": [1, 0, 0, 1], "glossinessFactor": 0.2}
    extensions = {"KHR_materials_pbrSpecularGlossiness": old}
    yield write_box(folder / "old.gltf", extensions=extensions).read_bytes()


def obj_files(folder: Path) -> Iterator[bytes]:
    """An OBJ and, after a line of ``%``, the material file it names."""
    cv2.imwrite(str(folder / "t.png"), np.full((4, 4, 3), 99, np.uint8))
    uv = "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
    material = (
        "newmtl red\nKd 0.8 0.1 0.1\nKs 1 1 1\nNs 50\nd 0.9\nmap_Kd t.png\nnewmtl b\nKd 0 0 0\n"
    )
    start = "mtllib m.mtl\no thing\ng part\ns 1\n" + TRIANGLES + uv + "usemtl red\n"
    yield (start + "f 1/1/1 2/2/1 3/3/1\nusemtl b\nf 1 2 4\n%\n" + material).encode()
    yield (TRIANGLES + "v 1 1 1 0.5 0.2 0.1\nf 1 2 3 4 5\nf -1 -2 -3\n%\n").encode()
    yield (start + "f 1//1 2//1 3//1 4//1\n%\n" + material.replace("t.png", "../t.png")).encode()


def mesh_files(folder: Path) -> Iterator[bytes]:
    """What casts shadows: numpy's own, and what trimesh reads, told apart by their first bytes."""
    import trimesh

    write_mesh(folder / "a.npz", small_mesh())
    yield (folder / "a.npz").read_bytes()
    with (folder / "b.npz").open("wb") as file:
        np.savez(file, vertices=small_mesh().vertices, faces=small_mesh().faces.astype(np.uint32))
    yield (folder / "b.npz").read_bytes()
    box = trimesh.creation.box()
    for kind in ("ply", "stl", "glb", "obj"):
        data = box.export(file_type=kind)
        yield data if isinstance(data, bytes) else data.encode()
    yield box.export(file_type="ply", encoding="ascii")
    yield box.export(file_type="stl_ascii").encode()


def manifests(folder: Path) -> Iterator[bytes]:
    """Of a tiny backbone, and of the one that comes along."""
    write_backbone(folder)
    yield (folder / "manifest.json").read_bytes()
    embedded = RUNTIME / "backbones/mini/manifest.json"
    if embedded.is_file():
        yield embedded.read_bytes()


def lights() -> Iterator[bytes]:
    """Lights by place and by shadow."""
    documents = [
        [{"azimuth": 135, "elevation": 45, "weight": 2, "colour": [1, 0.8, 0.6]}],
        {"lights": [{"position": [1, 2, 3], "frame": "camera", "radius": 0.2}]},
        {"lights": [{"shadow": "lamp.png", "negative": "lamp.png", "weight": 2}]},
        [{"azimuth": 1, "elevation": 2, "distance": None}, {"shadow": "lamp.png"}],
    ]
    for document in documents:
        yield json.dumps(document).encode()


def published(folder: Path) -> Path:
    """The estimates that lie beside a published scene's layers."""
    scene = make_scene(*SIZE)
    albedo = scene.background_maps.albedo
    write_image(folder / "ball_bg_diffuse.png", albedo)
    write_image(folder / "ball_bg_normal.png", albedo)
    write_image(folder / "ball_bg_depth.exr", scene.background_maps.depth)
    write_image(folder / "ball_bg_roughness.png", albedo[..., 0])
    return folder


def fresh(folder: Path) -> Path:
    """An empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
