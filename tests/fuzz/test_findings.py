"""What fuzzing and looking for it found, mended: each file that once did more than be refused."""

import io
import json
import struct
import zipfile
from contextlib import nullcontext

import numpy as np
import OpenEXR
import pytest
from support.models import QUAD, QUAD_FACES, GltfBuilder
from support.scenes import make_scene

pytest.importorskip("trimesh", reason="models need the extra scene")
pytest.importorskip("embreex", reason="models need the extra scene")

from fuzz import seeds
from fuzz.guard import peak_memory
from spotlight_runtime import Scene, read_image, write_image
from spotlight_runtime.composing import gltf, gltf_scene, product
from spotlight_runtime.composing.cutout import read_cutout
from spotlight_runtime.composing.product import smooth_normals
from spotlight_runtime.composing.product_files import load_product
from spotlight_runtime.errors import (
    ImageFileError,
    InvalidInputError,
    ModelIntegrityError,
    NonFiniteError,
    ProductError,
    SceneError,
    ShapeError,
    UnsafePathError,
)
from spotlight_runtime.geometry.mesh_files import read_mesh
from spotlight_runtime.imaging import headers
from spotlight_runtime.networks.models import open_networks, resolve_model
from spotlight_runtime.relighting.lights_file import read_lights
from spotlight_runtime.relighting.shadow_files import read_shadow
from spotlight_runtime.scenes.archive import MAX_ZIP_ENTRIES
from spotlight_runtime.scenes.testset import load_published
from spotlight_spec import Manifest, RecordError, decode, read_json

FLAT = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
LONG = "n" * 300


# JSON


def test_a_million_keys_are_read_in_one_pass(tmp_path):
    """Counting each key among all of them took hours."""
    keys = {f"k{i}": i for i in range(300_000)}
    (tmp_path / "a.json").write_text(json.dumps(keys))
    assert read_json(tmp_path / "a.json") == keys


@pytest.mark.parametrize("depth", range(900, 1000, 7))
def test_value_nested_just_less_deep_than_the_parser_allows(depth):
    nested = None
    for _ in range(depth):
        nested = [nested]
    with pytest.raises(RecordError, match="expected a number"):
        decode(float, nested)


# Models


def test_manifest_with_a_name_no_file_can_have(tmp_path):
    next(seeds.manifests(tmp_path))
    text = (tmp_path / "manifest.json").read_text()
    (tmp_path / "manifest.json").write_text(text.replace("denoiser.onnx", LONG))
    with pytest.raises(ModelIntegrityError, match="is missing"):
        open_networks(resolve_model(tmp_path))
    assert Manifest.read(tmp_path).damaged_files(tmp_path)


# Scenes


@pytest.fixture
def bundle(tmp_path):
    return seeds.write_scene(tmp_path / "scene")


def rewrite(bundle, **changes):
    document = json.loads((bundle / "scene.json").read_text())
    (bundle / "scene.json").write_text(json.dumps(document | changes))


def test_mesh_with_a_name_no_file_can_have(bundle):
    rewrite(bundle, object_geometry={"file": LONG + ".npz"})
    with pytest.raises(SceneError, match="found no file"):
        Scene.load(bundle)


@pytest.mark.parametrize(
    "image",
    [{"file": "small.png", "enlarged": True}, {"file": "small.png", "corner": [0, 0]}],
    ids=["enlarged", "part"],
)
def test_few_pixels_do_not_become_gigabytes_because_scene_json_says_so(bundle, image):
    background = json.loads((bundle / "scene.json").read_text())["background"]
    rewrite(bundle, width=60_000, height=60_000, background=background | {"image": image})

    def load():
        with pytest.raises(ShapeError, match="at most 64 megapixels"):
            Scene.load(bundle)

    assert peak_memory(load) < 64 << 20


def test_zip_of_too_many_files_is_refused_before_one_is_written(tmp_path):
    archive = tmp_path / "many.zip"
    with zipfile.ZipFile(archive, "w") as made:
        for i in range(MAX_ZIP_ENTRIES + 1):
            made.writestr(f"{i}/{i}", b"")
    with pytest.raises(SceneError, match=r"many\.zip: holds 2001 files, more than the limit"):
        Scene.load(archive)


def test_zip_that_says_it_lies_on_several_disks(tmp_path):
    """`zipfile.is_zipfile` raises of it."""
    archive = tmp_path / "disks.zip"
    with zipfile.ZipFile(archive, "w") as made:
        made.writestr("scene.json", "{}")
    data = archive.read_bytes()
    end = data.rindex(b"PK\x05\x06")
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, 0, 5)
    archive.write_bytes(data[:end] + locator + data[end:])
    with pytest.raises(SceneError, match=r"disks\.zip: cannot be unpacked"):
        Scene.load(archive)


def test_scene_with_a_name_no_file_can_have():
    with pytest.raises(SceneError, match="no scene here"):
        Scene.load(LONG)


@pytest.mark.parametrize("kind", [np.uint8, np.uint32, np.uint64])
def test_mesh_of_unsigned_rows_is_read(tmp_path, kind):
    mesh = seeds.small_mesh()
    np.savez(tmp_path / "a.npz", vertices=mesh.vertices, faces=mesh.faces.astype(kind))
    np.testing.assert_array_equal(read_mesh(tmp_path / "a.npz").faces, mesh.faces)


@pytest.mark.parametrize("row", [2**31, 2**32, 2**63, 2**64 - 1])
def test_mesh_of_rows_beyond_any_mesh_is_refused(tmp_path, row):
    faces = np.array([[0, 1, row]], np.uint64)
    np.savez(tmp_path / "a.npz", vertices=seeds.small_mesh().vertices, faces=faces)
    with pytest.raises(InvalidInputError, match="expected rows of 4 vertices"):
        read_mesh(tmp_path / "a.npz")


def test_infinite_contact_depth_is_an_error_not_a_warning(tmp_path):
    seeds.published(tmp_path)
    plane = np.full(seeds.SIZE, 0.5, np.float32)
    layers = ("background", "albedo", "mask", "footprint_depth")
    channels = {f"{layer}.{c}": plane for layer in layers for c in "RGBA"}
    for channel in "BA":
        channels[f"footprint_depth.{channel}"] = np.full_like(plane, np.inf)
    OpenEXR.File(dict(FLAT), channels).write(str(tmp_path / "ball_bundle0001.exr"))
    with pytest.raises(NonFiniteError, match="footprint_depth"):
        load_published(tmp_path)


# Lights


@pytest.mark.parametrize("key", ["shadow", "negative"])
@pytest.mark.parametrize("absolute", [True, False])
def test_shadow_outside_the_folder_of_the_lights_is_refused(tmp_path, key, absolute):
    folder = tmp_path / "lights"
    folder.mkdir()
    mask = make_scene(8, 8).object_mask
    for path in (folder / "in.png", tmp_path / "out.png"):
        write_image(path, mask)
    outside = str(tmp_path / "out.png") if absolute else "../out.png"
    (folder / "a.json").write_text(json.dumps([{"shadow": "in.png", key: outside}]))
    with pytest.raises(UnsafePathError, match=r"lights\[0\]: .*out\.png' lies outside"):
        read_lights(folder / "a.json")


@pytest.mark.parametrize("name", ["a\0b.png", LONG + ".png"])
def test_shadow_with_a_name_no_file_can_have(tmp_path, name):
    (tmp_path / "a.json").write_text(json.dumps([{"shadow": name}]))
    with pytest.raises((InvalidInputError, ImageFileError)):
        read_lights(tmp_path / "a.json")


@pytest.mark.parametrize("values", [(np.nan, 0.0), (np.inf, -np.inf)])
def test_shadow_that_is_not_finite_is_an_error_not_a_warning(tmp_path, values):
    pixels = np.zeros((4, 4, 3), np.float32)
    pixels[0, 0, :2] = values
    write_image(tmp_path / "a.exr", pixels)
    with pytest.raises(NonFiniteError, match=r"a\.exr: the shadow holds NaN or infinity"):
        read_shadow(tmp_path / "a.exr")


def test_mask_of_a_cutout_may_be_of_any_floats(tmp_path):
    picture = np.full((40, 48, 3), 0.5, np.float32)
    write_image(tmp_path / "p.png", picture)
    mask = np.zeros_like(picture)
    mask[:20] = np.inf
    mask[0, 0] = [np.inf, -np.inf, np.nan]
    write_image(tmp_path / "m.exr", mask)
    cover = read_cutout(tmp_path / "p.png", tmp_path / "m.exr").mask
    assert cover[5:20].min() > 0.99
    assert not cover[20:].any()


# Pictures


def test_size_among_the_comments_of_a_radiance_file_says_nothing(tmp_path):
    """The decoder reads the one after the empty line, and would have taken gigabytes."""
    start = b"#?RADIANCE\n-Y 1 +X 1\nFORMAT=32-bit_rle_rgbe\n\n"
    (tmp_path / "bomb.hdr").write_bytes(start + b"-Y 20000 +X 20000\n" + b"\x02\x02\x4e\x20" * 9)
    with pytest.raises(ImageFileError, match="at most 64 megapixels"):
        read_image(tmp_path / "bomb.hdr")


def test_png_chunk_that_claims_gigabytes(tmp_path):
    """Found by fuzzing: a hundred bytes that OpenCV allocated three and a half gigabytes for."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", 4, 2, 8, 0, 0, 0, 0)), (b"tEXt", b"a\0b")]
    data = seeds.png(chunks)
    claim = data.index(b"tEXt") - 4
    (tmp_path / "a.png").write_bytes(data[:claim] + b"\xd8\xff\xff\xff" + data[claim + 4 :])
    refused_by_its_header(tmp_path / "a.png", r"a\.png: expected a whole image file, got a trunc")


def test_png_chunk_that_claims_gigabytes_after_the_end(tmp_path):
    """Likewise: of a picture without pixels, OpenCV went on beyond its end."""
    data = seeds.png([(b"IHDR", struct.pack(">IIBBBBB", 4, 2, 8, 0, 0, 0, 0))])
    (tmp_path / "a.png").write_bytes(data + b"\xff\xff\xff\xf8IEND\0\0\0\0")
    refused_by_its_header(tmp_path / "a.png", r"a\.png: expected a whole image file")


def test_png_with_something_after_its_end_is_read(tmp_path):
    write_image(tmp_path / "a.png", np.full((4, 4, 3), 0.5, np.float32))
    with (tmp_path / "a.png").open("ab") as file:
        file.write(b"appended by some camera")
    assert read_image(tmp_path / "a.png").shape == (4, 4, 3)


def refused_by_its_header(path, match):
    def read():
        with pytest.raises(ImageFileError, match=match):
            read_image(path)

    assert peak_memory(read) < 64 << 20


def test_exr_whose_size_comes_late_in_the_header(tmp_path, monkeypatch):
    monkeypatch.setattr(headers, "MAX_PIXELS", 1 << 20)
    path = tmp_path / "late.exr"
    pixels = np.zeros((2000, 2000), np.float32)
    OpenEXR.File({**FLAT, "aaa": "y" * 200_000}, {"V": pixels}).write(str(path))
    refused_by_its_header(path, "header says 2000×2000")
    OpenEXR.File({**FLAT, "aaa": "y" * (1 << 20)}, {"V": pixels}).write(str(path))
    refused_by_its_header(path, "header is damaged or longer than 1 MiB")


def test_exr_whose_second_part_is_gigantic(tmp_path, monkeypatch):
    monkeypatch.setattr(headers, "MAX_PIXELS", 1 << 20)
    window = {"displayWindow": (np.int32([0, 0]), np.int32([1999, 1999]))}
    first = {"name": "a", "dataWindow": (np.int32([0, 0]), np.int32([3, 3])), **window}
    parts = [
        OpenEXR.Part({**FLAT, **first}, {"a.V": np.zeros((4, 4), np.float32)}, "a"),
        OpenEXR.Part({**FLAT, "name": "b", **window}, {"b.V": np.zeros((2000, 2000), "f4")}, "b"),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    refused_by_its_header(tmp_path / "parts.exr", "header says 2000×2000")


def test_exr_of_very_many_channels(tmp_path, monkeypatch):
    monkeypatch.setattr(headers, "MAX_SAMPLES", 1 << 20)
    channels = {f"c{i}.V": np.zeros((200, 200), np.float16) for i in range(100)}
    OpenEXR.File(dict(FLAT), channels).write(str(tmp_path / "many.exr"))
    refused_by_its_header(tmp_path / "many.exr", "200×200 pixels of 100 channels")


# 3-D models


def quad(**fields):
    builder = GltfBuilder()
    node = builder.node(builder.primitive(QUAD_FACES, POSITION=builder.accessor(QUAD)), **fields)
    return builder, node


def test_number_beyond_any_float(tmp_path):
    builder, _ = quad(rotation=[10**400, 0, 0, 1])
    with pytest.raises(ProductError, match="malformed glTF"):
        load_product(builder.write(tmp_path / "a.glb"))


@pytest.mark.parametrize("buffers", [3, [7]])
def test_buffers_that_are_none(tmp_path, buffers):
    builder, _ = quad()
    tree = builder.tree | {"buffers": buffers}
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(ProductError, match="malformed glTF"):
        load_product(tmp_path / "a.gltf")


def test_nodes_that_share_their_children_are_refused(tmp_path):
    """Forty of them, each twice the child of the one before, took longer than anyone waits."""
    builder, _ = quad()
    first = len(builder.tree["nodes"])
    shared = [{"children": [first + i + 1] * 2} for i in range(40)]
    builder.tree["nodes"] += [*shared, {"mesh": 0}]
    builder.tree["scenes"][0]["nodes"] = [first]
    with pytest.raises(ProductError, match="has two parents"):
        load_product(builder.write(tmp_path / "a.glb"))


def test_one_mesh_shown_a_million_times(tmp_path, monkeypatch):
    monkeypatch.setattr(product, "MAX_TRIANGLES", 1000)
    builder, node = quad()
    builder.tree["nodes"] += [{"mesh": 0}] * 100_000
    builder.tree["scenes"][0]["nodes"] = list(range(node, 100_000))
    with pytest.raises(ProductError, match="expected at most 1000 triangles, got 100"):
        load_product(builder.write(tmp_path / "a.glb"))


def test_accessor_that_claims_values_no_file_holds(tmp_path):
    builder, _ = quad()
    some = {"bufferView": 0, "componentType": 5123}
    sparse = {"count": 0, "indices": some, "values": {"bufferView": 0}}
    entry = {"componentType": 5126, "count": gltf.MAX_SPARSE + 1, "type": "VEC3", "sparse": sparse}
    builder.tree["accessors"][0] = entry

    def load():
        with pytest.raises(ProductError, match="claims 10000001 values that are not in the file"):
            load_product(builder.write(tmp_path / "a.glb"))

    assert peak_memory(load) < 64 << 20


def test_indices_that_are_no_whole_numbers(tmp_path):
    builder = GltfBuilder()
    primitive = builder.primitive(None, POSITION=builder.accessor(QUAD))
    primitive["indices"] = builder.accessor(np.float32([0, 1, np.nan]))
    builder.node(primitive)
    with pytest.raises(ProductError, match="expected indices as unsigned whole numbers"):
        load_product(builder.write(tmp_path / "a.glb"))


def test_as_many_corners_in_one_place_as_a_damaged_file_may_have():
    """All pairs of them were compared at once: of thirty thousand, seven gigabytes."""
    faces = np.arange(30_000, dtype=np.int32).reshape(-1, 3)
    vertices = np.zeros((30_000, 3), np.float32)
    vertices[1::3, 0] = vertices[2::3, 1] = np.arange(1, 10_001)
    assert peak_memory(lambda: smooth_normals(vertices, faces)) < 64 << 20
    np.testing.assert_allclose(smooth_normals(vertices, faces), [[[0, 0, 1]] * 3] * 10_000)


def test_pairs_compared_in_pieces_are_the_pairs(monkeypatch):
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(60, 3)).astype(np.float32)
    faces = rng.integers(0, 60, (400, 3)).astype(np.int32)
    whole = smooth_normals(vertices, faces)
    monkeypatch.setattr(product, "PAIRS", 100)
    np.testing.assert_array_equal(smooth_normals(vertices, faces), whole)


@pytest.mark.parametrize("scale", [1e30, 3e38])
def test_very_large_model_overflows_nothing_on_the_way(tmp_path, scale):
    builder = GltfBuilder()
    large = QUAD * np.float32(scale)
    fields = {"POSITION": builder.accessor(large), "NORMAL": builder.accessor(large)}
    builder.node(builder.primitive(QUAD_FACES, **fields))
    read = load_product(builder.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(np.linalg.norm(read.normals, axis=1), 1.0, rtol=1e-5)


def textured_by_many(tmp_path, materials, images):
    builder = GltfBuilder()
    pixels = np.zeros((64, 64, 4), np.uint8)
    textures = [builder.image(pixels) for _ in range(images)]
    for i in range(materials):
        texture = {"baseColorTexture": {"index": textures[i % images]}}
        material = builder.material(pbrMetallicRoughness=texture)
        builder.node(
            builder.primitive(QUAD_FACES, POSITION=builder.accessor(QUAD), material=material)
        )
    return builder.write(tmp_path / "a.glb")


def test_materials_share_the_images_they_share(tmp_path):
    read = load_product(textured_by_many(tmp_path, materials=5, images=1))
    assert len(read.materials) == 5
    assert len({id(material.base_texture.levels) for material in read.materials}) == 1


def test_more_texels_than_memory_has_room_for(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf_scene, "MAX_TEXELS", 3 * 64 * 64)
    path = textured_by_many(tmp_path, materials=4, images=4)
    with pytest.raises(ProductError, match="expected textures of at most 0 megapixels in all"):
        load_product(path)


OBJ = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl red\nf 1/1 2/1 3/1\n"


@pytest.mark.parametrize(
    ("material", "passed"),
    [
        ("Kd 0Kd 0 0", True),
        ("Kd 1 x 1", True),
        ("Kd 1 1", True),
        ("d 0Kd 1", False),
        ("Ns", True),
        ("d", True),
        ("Ns nan", True),
    ],
)
def test_obj_material_of_other_words(tmp_path, material, passed):
    """A material that says nothing is passed over, one that says nonsense refused."""
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "m.mtl").write_text(f"newmtl red\n{material}\n")
    with nullcontext() if passed else pytest.raises(ProductError, match="expected an OBJ model"):
        assert len(load_product(tmp_path / "a.obj").faces) == 1


def test_obj_with_vertices_of_two_numbers(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(ProductError, match="expected an OBJ model"):
        load_product(tmp_path / "a.obj")


def test_npz_that_claims_more_than_it_holds(tmp_path):
    header = io.BytesIO()
    claim = {"descr": "<f4", "fortran_order": False, "shape": (10**8, 3)}
    np.lib.format.write_array_header_1_0(header, claim)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as made:
        for name in ("vertices.npy", "faces.npy"):
            made.writestr(name, header.getvalue())

    def read():
        with pytest.raises(SceneError, match="expected arrays vertices and faces"):
            read_mesh(tmp_path / "a.npz")

    assert peak_memory(read) < 64 << 20
