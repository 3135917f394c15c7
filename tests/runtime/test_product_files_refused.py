"""Every way a file can be no model, or one that is not to be read."""

import base64
import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.models import (
    QUAD,
    QUAD_FACES,
    QUAD_UV,
    GltfBuilder,
    glb,
    obj_files,
    write_box,
)

from spotlight_runtime.composing.product import assemble
from spotlight_runtime.errors import (
    ImageFileError,
    MissingExtraError,
    ProductError,
    SpotLightError,
    UnsafePathError,
)

pytest.importorskip("embreex", reason="products need the extra scene")
pytest.importorskip("trimesh", reason="products need the extra scene")

from spotlight_runtime.composing import product_files
from spotlight_runtime.composing.product_files import load_product


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj"])
@pytest.mark.parametrize(
    "content", [b"", b"hello", b"\x89PNG\r\n\x1a\n", b"{}", b"[]", b"\xff\xfe"]
)
def test_file_that_is_no_model(tmp_path, suffix, content):
    path = tmp_path / f"chair{suffix}"
    path.write_bytes(content)
    with pytest.raises(ProductError, match=r"chair.*(expected|empty)"):
        load_product(path)


def test_missing_file_and_foreign_suffix(tmp_path):
    with pytest.raises(ProductError, match=r"none\.glb.*no such file"):
        load_product(tmp_path / "none.glb")
    with pytest.raises(ProductError, match=r"expected a model \(\.glb, \.gltf, \.obj\).*'\.fbx'"):
        load_product(tmp_path / "chair.fbx")


def test_obj_has_no_variants(tmp_path):
    with pytest.raises(ProductError, match="no variants"):
        load_product(obj_files(tmp_path), "Oak")


def test_empty_mesh(tmp_path):
    builder = GltfBuilder()
    builder.node()
    with pytest.raises(ProductError, match=r"empty.*expected triangles.*export"):
        load_product(builder.write(tmp_path / "empty.glb"))
    (tmp_path / "empty.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    with pytest.raises(ProductError, match=r"empty"):
        load_product(tmp_path / "empty.obj")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite(tmp_path, value):
    builder = GltfBuilder()
    points = QUAD.copy()
    points[1, 1] = value
    builder.node(builder.primitive(QUAD_FACES, POSITION=builder.accessor(points)))
    with pytest.raises(ProductError, match=r"1 of 4 vertices are NaN or infinite; repair"):
        load_product(builder.write(tmp_path / "bad.glb"))


def test_faces_of_vertices_that_are_not_there(tmp_path):
    builder = GltfBuilder()
    builder.node(builder.primitive([0, 1, 7], POSITION=builder.accessor(QUAD)))
    with pytest.raises(ProductError, match=r"faces of 4 vertices, got indices from 0 to 7"):
        load_product(builder.write(tmp_path / "bad.glb"))


@pytest.mark.parametrize("points", [np.zeros((3, 3)), [[0, 0, 0], [1, 1, 1], [2, 2, 2]]])
def test_mesh_without_extent(tmp_path, points):
    builder = GltfBuilder()
    builder.node(builder.primitive([0, 1, 2], POSITION=builder.accessor(points)))
    flat = np.ptp(np.asarray(points), axis=0).max() == 0
    if flat:
        with pytest.raises(ProductError, match="without extent"):
            load_product(builder.write(tmp_path / "point.glb"))
    else:  # a diagonal line has a box, but no area: it is seen to be nothing later
        assert len(load_product(builder.write(tmp_path / "line.glb")).faces) == 1


def test_nan_texture_coordinates_and_zero_normals(tmp_path):
    builder = GltfBuilder()
    uv = QUAD_UV.copy()
    uv[0] = np.nan
    at = builder.accessor(QUAD)
    builder.node(builder.primitive(QUAD_FACES, POSITION=at, TEXCOORD_0=builder.accessor(uv)))
    with pytest.raises(ProductError, match="texture coordinates are NaN"):
        load_product(builder.write(tmp_path / "bad.glb"))
    builder = GltfBuilder()
    normals = builder.accessor(np.zeros((4, 3)))
    builder.node(builder.primitive(QUAD_FACES, POSITION=builder.accessor(QUAD), NORMAL=normals))
    product = load_product(builder.write(tmp_path / "fine.glb"))
    np.testing.assert_allclose(product.normals, [[0, 0, 1]] * 6)


def textured(folder, uri, *, write=True):
    builder = GltfBuilder()
    texture = builder.image(np.full((4, 4, 3), 200, np.uint8), uri)
    material = builder.material(pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
    builder.node(
        builder.primitive(
            QUAD_FACES,
            POSITION=builder.accessor(QUAD),
            TEXCOORD_0=builder.accessor(QUAD_UV),
            material=material,
        )
    )
    path = builder.write(folder / "chair.gltf")
    if write:
        cv2.imwrite(str(folder / "wood grain.png"), np.full((4, 4, 3), 200, np.uint8))
    return path


@pytest.mark.parametrize("uri", ["wood%20grain.png", "wood grain.png", "./wood%20grain.png"])
def test_texture_beside_the_model(tmp_path, uri):
    assert load_product(textured(tmp_path, uri)).materials[0].base_texture.size == (4, 4)


def test_missing_texture_is_named(tmp_path):
    with pytest.raises(ProductError, match=r"expected the texture 'oak\.png' beside the model"):
        load_product(textured(tmp_path, "oak.png"))
    path = obj_files(tmp_path, material="newmtl red\nmap_Kd gone.png\n", lines="vt 0 0\n")
    with pytest.raises(ProductError, match=r"texture 'gone\.png'"):
        load_product(path)


def test_missing_buffer_and_material_file_are_named(tmp_path):
    path = write_box(tmp_path / "box.gltf")
    (tmp_path / "box.bin").unlink()
    with pytest.raises(ProductError, match=r"buffer 'box\.bin'"):
        load_product(path)
    path = obj_files(tmp_path)
    (tmp_path / "a.mtl").unlink()
    with pytest.raises(ProductError, match=r"material file 'a\.mtl'"):
        load_product(path)


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.png",
        "sub/../../secret.png",
        "/etc/passwd",
        "%2e%2e/secret.png",
        "https://example.com/t.png",
        "file:///etc/passwd",
        "//server/share/t.png",
        "..\\secret.png",
    ],
)
def test_paths_that_leave_the_folder_are_refused(tmp_path, uri):
    folder = tmp_path / "model"
    folder.mkdir()
    (tmp_path / "secret.png").write_bytes(b"x")
    with pytest.raises(UnsafePathError, match=r"outside the model's folder.*copy it beside"):
        load_product(textured(folder, uri))
    material = f"newmtl red\nmap_Kd {uri}\n"
    if "%" not in uri:
        with pytest.raises((UnsafePathError, ProductError)):
            load_product(obj_files(folder, material=material, lines="vt 0 0\n"))


def test_link_that_leaves_the_folder_is_refused(tmp_path):
    folder = tmp_path / "model"
    folder.mkdir()
    cv2.imwrite(str(tmp_path / "secret.png"), np.zeros((4, 4, 3), np.uint8))
    (folder / "wood.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(UnsafePathError):
        load_product(textured(folder, "wood.png"))


@pytest.mark.parametrize("uri", ["a\0b.png", "n" * 300 + ".png", "", ".", 7])
def test_names_no_file_has(tmp_path, uri):
    with pytest.raises(ProductError):
        load_product(textured(tmp_path, uri))


def test_texture_that_is_none_or_too_large(tmp_path):
    path = textured(tmp_path, "t.png")
    (tmp_path / "t.png").write_bytes(b"not an image")
    with pytest.raises(ImageFileError, match=r"chair\.gltf: texture 't\.png'"):
        load_product(path)
    header = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes()
    claims = header[:16] + (60_000).to_bytes(4, "big") * 2 + header[24:]
    (tmp_path / "t.png").write_bytes(claims)
    with pytest.raises(ImageFileError, match="64 megapixels"):
        load_product(path)
    (tmp_path / "t.png").write_bytes(b"")
    with pytest.raises(ProductError, match="empty file"):
        load_product(path)


def test_embedded_data(tmp_path):
    builder = GltfBuilder()
    builder.node(builder.primitive(QUAD_FACES, POSITION=builder.accessor(QUAD)))
    encoded = base64.b64encode(builder.data).decode()
    for payload, whole in ((encoded, True), ("@@@", False), (encoded[:8], False)):
        uri = f"data:application/octet-stream;base64,{payload}"
        tree = {**builder.tree, "buffers": [{"uri": uri, "byteLength": len(builder.data)}]}
        path = tmp_path / "a.gltf"
        path.write_text(json.dumps(tree))
        if whole:
            assert len(load_product(path).faces) == 2
        else:
            with pytest.raises(ProductError, match="export the model again"):
                load_product(path)


@pytest.mark.parametrize("extension", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
def test_required_extension_that_is_not_understood(tmp_path, extension):
    builder = GltfBuilder()
    builder.tree["extensionsRequired"] = [extension]
    with pytest.raises(ProductError, match=rf"needs {extension}.*without"):
        load_product(builder.write(tmp_path / "a.glb"))


def test_mesh_whose_data_is_compressed_away(tmp_path):
    builder = GltfBuilder()
    builder.tree["accessors"].append({"count": 3, "componentType": 5126, "type": "VEC3"})
    builder.node(builder.primitive(None, POSITION=0))
    with pytest.raises(ProductError, match="without mesh compression"):
        load_product(builder.write(tmp_path / "a.glb"))


def test_texture_only_in_a_compressed_format(tmp_path):
    path = textured(tmp_path, "wood grain.png")
    tree = json.loads(path.read_text())
    del tree["textures"][0]["source"]
    path.write_text(json.dumps(tree))
    with pytest.raises(ProductError, match="PNG or JPEG textures"):
        load_product(path)


@pytest.mark.parametrize(
    "edit",
    [
        lambda t: t["accessors"][0].update(count=10**9),
        lambda t: t["accessors"][0].update(count=-1),
        lambda t: t["accessors"][0].update(count=True),
        lambda t: t["accessors"][0].update(componentType=1),
        lambda t: t["accessors"][0].update(type="MAT9"),
        lambda t: t["accessors"][0].update(byteOffset=-4),
        lambda t: t["accessors"][0].update(bufferView=99),
        lambda t: t["bufferViews"][0].update(byteLength=10**9),
        lambda t: t["bufferViews"][0].update(byteOffset=-8),
        lambda t: t["bufferViews"][0].update(byteStride=1),
        lambda t: t["bufferViews"][0].update(buffer=3),
        lambda t: t["meshes"][0].update(primitives=None),
        lambda t: t["nodes"][0].update(mesh=5),
        lambda t: t["nodes"][0].update(rotation=[0, 0]),
        lambda t: t["nodes"][0].update(matrix=[1, 2, 3]),
        lambda t: t["nodes"][0].update(children=[0]),
        lambda t: t["nodes"].__setitem__(0, 7),
        lambda t: t.update(scene=4),
        lambda t: t["asset"].update(version="1.0"),
        lambda t: t.update(asset={}),
    ],
)
def test_malformed_gltf_is_an_error_of_the_tree(tmp_path, edit):
    path = write_box(tmp_path / "box.gltf")
    tree = json.loads(path.read_text())
    edit(tree)
    path.write_text(json.dumps(tree))
    with pytest.raises(ProductError, match=r"box.*(export|glTF 2\.0)"):
        load_product(path)


@given(data=st.data())
def test_damaged_glb_is_an_error_of_the_tree_or_a_model(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    whole = write_box(folder / "box.glb").read_bytes()
    kind = data.draw(st.sampled_from(["cut", "flip"]))
    if kind == "cut":
        damaged = whole[: data.draw(st.integers(0, len(whole) - 1))]
    else:
        at = data.draw(st.integers(0, len(whole) - 1))
        damaged = whole[:at] + bytes([data.draw(st.integers(0, 255))]) + whole[at + 1 :]
    (folder / "box.glb").write_bytes(damaged)
    try:
        product = load_product(folder / "box.glb")
    except SpotLightError:
        return
    assert np.isfinite(product.vertices).all()
    assert len(product.faces)


def test_glb_of_another_version_and_without_json(tmp_path):
    path = tmp_path / "a.glb"
    path.write_bytes(b"glTF\1\0\0\0\x14\0\0\0" + b"\0" * 8)
    with pytest.raises(ProductError, match=r"GLB 2\.0.*version 1"):
        load_product(path)
    path.write_bytes(glb(b"{}")[:12])
    with pytest.raises(ProductError, match="whole GLB"):
        load_product(path)


def test_too_many_triangles(monkeypatch, tmp_path):
    monkeypatch.setattr("spotlight_runtime.composing.product.MAX_TRIANGLES", 5)
    with pytest.raises(ProductError, match=r"at most 5 triangles, got 12; decimate"):
        load_product(write_box(tmp_path / "a.glb"))


def test_missing_extra_names_the_command(monkeypatch, tmp_path):
    monkeypatch.setattr(product_files.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install 'spotlight-relight\[scene\]'"):
        load_product(tmp_path / "a.glb")


def test_nothing_to_assemble():
    with pytest.raises(ProductError, match="empty mesh"):
        assemble([], "none")
