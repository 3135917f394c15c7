"""What fuzzing found in readers of 3-D models, mended."""

import io
import json
import zipfile
from contextlib import nullcontext

import numpy as np
import pytest
from support.models import QUAD, QUAD_FACES, GltfBuilder

pytest.importorskip("trimesh", reason="models need the extra scene")
pytest.importorskip("embreex", reason="models need the extra scene")

from fuzz.guard import peak_memory
from spotlight_runtime.composing import gltf, gltf_scene, product
from spotlight_runtime.composing.product import smooth_normals
from spotlight_runtime.composing.product_files import load_product
from spotlight_runtime.errors import (
    ProductError,
    SceneError,
)
from spotlight_runtime.geometry.mesh_files import read_mesh


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
