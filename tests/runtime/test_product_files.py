"""Models read as their formats say."""

import cv2
import numpy as np
import pytest
from support.models import (
    QUAD,
    QUAD_FACES,
    QUAD_UV,
    GltfBuilder,
    obj_files,
    sphere_arrays,
    write_box,
)

from spotlight_runtime.composing.materials import Material
from spotlight_runtime.composing.product import Piece, assemble, smooth_normals, weld
from spotlight_runtime.errors import (
    InvalidInputError,
    ProductError,
)

pytest.importorskip("embreex", reason="products need the extra scene")
pytest.importorskip("trimesh", reason="products need the extra scene")

from spotlight_runtime.composing.product_files import load_product


def corners(product):
    """World positions of the faces' corners, order-free."""
    return np.sort(product.vertices[product.faces].reshape(-1, 9), axis=0)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_box_in_both_containers(tmp_path, suffix):
    product = load_product(write_box(tmp_path / f"box{suffix}", (1.0, 2.0, 3.0)))
    low, high = product.bounds
    np.testing.assert_allclose(low, [-0.5, 0.0, -1.5])
    np.testing.assert_allclose(high, [0.5, 2.0, 1.5])
    assert len(product.faces) == 12
    assert product.name == "box"


def test_normals_of_a_box_without_them_are_its_faces(tmp_path):
    product = load_product(write_box(tmp_path / "box.glb"))
    points = product.vertices[product.faces]
    flat = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    for corner in range(3):
        np.testing.assert_allclose(product.normals[product.faces[:, corner]], flat, atol=1e-6)


def test_normals_of_a_sphere_without_them_are_smooth():
    vertices, faces, exact = sphere_arrays(2.0, rings=30)
    # At the poles one side of every other triangle is a point.
    points = vertices[faces]
    area = np.linalg.norm(
        np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1
    )
    faces = faces[area > 1e-4]
    angles = np.einsum("fcx,fcx->fc", smooth_normals(vertices, faces), exact[faces])
    assert np.degrees(np.arccos(np.clip(angles, -1, 1))).max() < 3.5


def test_weld_finds_the_same_places_and_no_others(rng):
    points = rng.normal(size=(500, 3)).astype(np.float32)
    points[250:] = points[rng.integers(250, size=250)]
    points[0], points[1] = [0.0, 1.0, -0.0], [-0.0, 1.0, 0.0]
    wanted = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)
    found = weld(points)
    assert ((found[:, None] == found[None]) == (wanted[:, None] == wanted[None])).all()


def test_scene_graph_moves_turns_scales_and_nests(tmp_path):
    builder = GltfBuilder()
    triangle = builder.primitive([0, 1, 2], POSITION=builder.accessor(np.eye(3)))
    child = builder.node(triangle, root=False, translation=[1, 0, 0], scale=[2, 2, 2])
    half = np.sqrt(0.5)
    builder.node(rotation=[0, half, 0, half], children=[child])  # a quarter turn about y
    matrix = np.diag([1.0, 3.0, 1.0, 1.0])
    matrix[:3, 3] = [0, 5, 0]
    builder.tree["nodes"].append({"mesh": 0, "matrix": matrix.T.ravel().tolist()})
    builder.tree["scenes"][0]["nodes"].append(2)
    product = load_product(builder.write(tmp_path / "nested.glb"))
    turned = (np.eye(3) * 2 + [1, 0, 0]) @ np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_allclose(product.vertices[product.faces[0]], turned, atol=1e-6)
    raised = np.eye(3) * [1, 3, 1] + [0, 5, 0]
    np.testing.assert_allclose(product.vertices[product.faces[1]], raised, atol=1e-6)


@pytest.mark.parametrize("useless", [0.0, 1e-30, np.inf, np.nan])
def test_normals_that_say_no_direction_are_made_anew(useless):
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    normals = np.float32([[0, 0, 1], [0, 0, 1], [0, 0, useless]])
    piece = Piece(corners, np.int32([[0, 1, 2]]), Material(), normals)
    product = assemble([piece], "triangle")
    np.testing.assert_array_equal(product.normals, np.tile(np.float32([0, 0, 1]), (3, 1)))


def test_normals_survive_uneven_scale(tmp_path):
    builder = GltfBuilder()
    slope = np.float32([[0, 0, 0], [1, 1, 0], [0, 0, -1]])
    normal = np.tile(np.float32([-1, 1, 0]) / np.sqrt(2), (3, 1))
    primitive = builder.primitive(
        [0, 1, 2], POSITION=builder.accessor(slope), NORMAL=builder.accessor(normal)
    )
    builder.node(primitive, scale=[2, 1, 1])
    product = load_product(builder.write(tmp_path / "scaled.glb"))
    np.testing.assert_allclose(product.normals[0], np.array([-1, 2, 0]) / np.sqrt(5), atol=1e-6)


def test_no_scene_means_all_roots(tmp_path):
    builder = GltfBuilder()
    builder.node(builder.primitive(QUAD_FACES, POSITION=builder.accessor(QUAD)))
    del builder.tree["scenes"], builder.tree["scene"]
    assert len(load_product(builder.write(tmp_path / "a.glb")).faces) == 2


@pytest.mark.parametrize(
    ("mode", "order", "wanted"),
    [
        (4, [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 3], [[0, 1, 2], [3, 2, 1]]),
        (6, [0, 1, 3, 2], [[0, 1, 3], [0, 3, 2]]),
        (5, None, [[0, 1, 2], [3, 2, 1]]),
    ],
)
def test_lists_strips_and_fans(tmp_path, mode, order, wanted):
    builder = GltfBuilder()
    points = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    normals = builder.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    builder.node(
        builder.primitive(order, POSITION=builder.accessor(points), NORMAL=normals, mode=mode)
    )
    found = load_product(builder.write(tmp_path / "a.glb")).faces
    rolled = [sorted(np.roll(face, k).tolist() for k in range(3)) for face in found]
    assert rolled == [sorted(np.roll(face, k).tolist() for k in range(3)) for face in wanted]


def test_lines_and_points_are_passed_over(tmp_path):
    builder = GltfBuilder()
    at = builder.accessor(QUAD)
    builder.node(
        builder.primitive([0, 1], POSITION=at, mode=1),
        builder.primitive(QUAD_FACES, POSITION=at),
        builder.primitive(None, POSITION=at, mode=0),
    )
    assert len(load_product(builder.write(tmp_path / "a.glb")).faces) == 2


def test_interleaved_sparse_and_normalised_accessors(tmp_path):
    builder = GltfBuilder()
    rows = np.zeros(4, dtype=[("p", "<f4", 3), ("uv", "<u2", 2)])
    rows["p"], rows["uv"] = QUAD, np.round(QUAD_UV * 65535)
    view = builder.view(rows.tobytes(), byteStride=rows.dtype.itemsize)
    common = {"bufferView": view, "count": 4}
    builder.tree["accessors"] += [
        {**common, "componentType": 5126, "type": "VEC3"},
        {**common, "componentType": 5123, "type": "VEC2", "byteOffset": 12, "normalized": True},
    ]
    builder.tree["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": builder.view(np.uint16([2]).tobytes()), "componentType": 5123},
        "values": {"bufferView": builder.view(np.float32([9, 9, 9]).tobytes())},
    }
    builder.node(builder.primitive(QUAD_FACES, POSITION=0, TEXCOORD_0=1))
    product = load_product(builder.write(tmp_path / "a.glb"))
    wanted = QUAD.copy()
    wanted[2] = 9
    np.testing.assert_allclose(product.vertices, wanted[QUAD_FACES.ravel()])
    np.testing.assert_allclose(product.uv[:, 0], QUAD_UV[QUAD_FACES.ravel()])


def test_positions_that_are_only_sparse_start_at_zero(tmp_path):
    builder = GltfBuilder()
    builder.tree["accessors"].append(
        {
            "count": 3,
            "componentType": 5126,
            "type": "VEC3",
            "sparse": {
                "count": 2,
                "indices": {"bufferView": builder.view(b"\1\2"), "componentType": 5121},
                "values": {"bufferView": builder.view(np.eye(3, dtype="<f4")[:2].tobytes())},
            },
        }
    )
    builder.node(builder.primitive([0, 1, 2], POSITION=0))
    product = load_product(builder.write(tmp_path / "a.glb"))
    np.testing.assert_array_equal(product.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_material_factors_and_defaults(tmp_path):
    pbr = {"baseColorFactor": [0.1, 0.2, 0.3, 0.5], "metallicFactor": 0.25, "roughnessFactor": 0.75}
    path = write_box(
        tmp_path / "a.glb", pbrMetallicRoughness=pbr, alphaMode="MASK", alphaCutoff=0.3
    )
    material = load_product(path).materials[0]
    assert material.base_colour == (0.1, 0.2, 0.3, 0.5)
    assert (material.metallic, material.roughness) == (0.25, 0.75)
    assert (material.alpha, material.alpha_cutoff) == ("mask", 0.3)
    plain = load_product(write_box(tmp_path / "b.glb", name="plain")).materials[0]
    assert plain.base_colour == (1.0, 1.0, 1.0, 1.0)
    assert (plain.metallic, plain.roughness, plain.alpha) == (1.0, 1.0, "opaque")


def test_old_specular_glossiness_materials_keep_their_colour(tmp_path):
    old = {"diffuseFactor": [0.1, 0.2, 0.3, 1.0], "glossinessFactor": 0.4}
    path = write_box(tmp_path / "a.glb", extensions={"KHR_materials_pbrSpecularGlossiness": old})
    material = load_product(path).materials[0]
    assert material.base_colour == (0.1, 0.2, 0.3, 1.0)
    assert material.metallic == 0.0
    assert material.roughness == pytest.approx(0.6)


def test_variants_by_name(tmp_path):
    builder = GltfBuilder()
    names = ["Oak", "Pine"]
    for i in range(3):
        builder.material(pbrMetallicRoughness={"roughnessFactor": 0.1 * (i + 1)})
    primitive = builder.primitive(QUAD_FACES, POSITION=builder.accessor(QUAD), material=0)
    mappings = [{"material": 1, "variants": [0]}, {"material": 2, "variants": [1]}]
    primitive["extensions"] = {"KHR_materials_variants": {"mappings": mappings}}
    builder.tree["extensions"] = {
        "KHR_materials_variants": {"variants": [{"name": name} for name in names]}
    }
    builder.tree["extensionsRequired"] = ["KHR_materials_variants"]
    builder.node(primitive)
    path = builder.write(tmp_path / "a.glb")
    for variant, roughness in ((None, 0.1), ("Oak", 0.2), ("pine", 0.3)):
        assert load_product(path, variant).materials[0].roughness == pytest.approx(roughness)
    with pytest.raises(InvalidInputError, match=r"expected one of Oak, Pine, got 'Elm'"):
        load_product(path, "Elm")
    with pytest.raises(InvalidInputError, match="the model has no variants"):
        load_product(write_box(tmp_path / "b.glb"), "Oak")


def test_obj_with_its_material(tmp_path):
    product = load_product(obj_files(tmp_path))
    assert len(product.faces) == 12
    low, high = product.bounds
    np.testing.assert_allclose([low, high], [[-0.5, 0, -0.5], [0.5, 1, 0.5]])
    red, green, blue, alpha = product.materials[0].base_colour
    assert (red, green, blue, alpha) == pytest.approx((0.5, 0.25, 0.0, 1.0), abs=0.01)
    assert product.materials[0].roughness == pytest.approx(np.sqrt(2 / 100))
    assert product.materials[0].metallic == 0.0
    assert product.materials[0].alpha == "opaque"


def test_obj_that_is_half_clear(tmp_path):
    product = load_product(obj_files(tmp_path, material="newmtl red\nd 0.5\n"))
    assert product.materials[0].alpha == "blend"
    assert product.materials[0].base_colour[3] == 0.5


def test_obj_texture_is_upright(tmp_path):
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[0] = 255  # the top row is white
    cv2.imwrite(str(tmp_path / "t.png"), picture)
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 0 0 0\nmap_Kd t.png\n")
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    )
    product = load_product(tmp_path / "a.obj")
    texture = product.materials[0].base_texture
    assert product.materials[0].base_colour[:3] == (1.0, 1.0, 1.0)
    near_top = texture.sample(np.float32([[0.5, 0.125], [0.5, 0.625]]), np.zeros(2, np.float32))
    np.testing.assert_allclose(near_top[:, 0], [1.0, 0.0], atol=0.02)
    highest = product.uv[np.argmax(product.vertices[:, 1]), 0]
    assert highest[1] == pytest.approx(0.0)


def test_obj_normals_are_used(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0.6 0 0.8\nf 1//1 2//1 3//1\n")
    product = load_product(tmp_path / "a.obj")
    np.testing.assert_allclose(product.normals, [[0.6, 0, 0.8]] * 3, atol=1e-6)


def test_obj_in_vertex_colours(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n")
    product = load_product(tmp_path / "a.obj")
    order = np.argsort(product.vertices @ [1.0, 2.0, 0.0])
    np.testing.assert_allclose(product.colours[order, :3], np.eye(3), atol=0.01)


@pytest.mark.parametrize("width", [3, 4])
def test_embedded_texture_second_coordinates_and_vertex_colours(tmp_path, width):
    builder = GltfBuilder()
    texture = builder.image(np.full((4, 4, 3), 200, np.uint8))
    change = {"offset": [0.5, 0.25], "scale": [2.0, 3.0], "rotation": 0.0}
    info = {
        "index": texture,
        "texCoord": 1,
        "extensions": {"KHR_texture_transform": change},
    }
    builder.tree["samplers"] = [{"wrapS": 33071, "wrapT": 33648}]
    builder.tree["textures"][0]["sampler"] = 0
    material = builder.material(pbrMetallicRoughness={"baseColorTexture": info})
    colours = np.full((4, width), 128, np.uint8)
    builder.node(
        builder.primitive(
            QUAD_FACES,
            POSITION=builder.accessor(QUAD),
            TEXCOORD_1=builder.accessor(QUAD_UV),
            COLOR_0=builder.accessor(colours, "u1", normalized=True),
            material=material,
        )
    )
    product = load_product(builder.write(tmp_path / "a.glb"))
    found = product.materials[0].base_texture
    assert (found.uv_set, found.wrap) == (1, ("clamp", "mirror"))
    np.testing.assert_allclose(found.transform, [[2.0, 0.0, 0.5], [0.0, 3.0, 0.25]])
    np.testing.assert_allclose(product.uv[:, 1], QUAD_UV[QUAD_FACES.ravel()])
    assert product.colours[0, 0] == pytest.approx(128 / 255)
    assert product.colours[0, 3] == pytest.approx(1.0 if width == 3 else 128 / 255)


def test_obj_whose_texture_is_truncated(tmp_path):
    data = cv2.imencode(".png", np.zeros((64, 64, 3), np.uint8))[1].tobytes()
    (tmp_path / "t.png").write_bytes(data[:60])
    path = obj_files(tmp_path, material="newmtl red\nmap_Kd t.png\n", lines="vt 0 0\n")
    text = path.read_text()
    path.write_text(
        "".join(
            f"f {' '.join(c + '/1' for c in line.split()[1:])}\n"
            if line.startswith("f ")
            else line + "\n"
            for line in text.splitlines()
        )
    )
    with pytest.raises(ProductError, match="texture"):
        load_product(path)
