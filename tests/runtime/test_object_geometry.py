"""The object's mesh and the floor in a scene and its bundle."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from support.scenes import make_scene
from support.shadow_scenes import sphere_mesh

from spotlight_runtime import Scene
from spotlight_runtime.errors import (
    DtypeError,
    InvalidInputError,
    NonFiniteError,
    SceneError,
    ShapeError,
    UnsafePathError,
)
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.mesh import ObjectMesh

MESH = sphere_mesh((0.1, -0.2, -3.0), 0.5, rings=12)
NPZ = "object_mesh.npz"
GROUND = Ground((0.0, 0.8, 0.6), -1.25)


@pytest.fixture
def bundle(tmp_path):
    folder = tmp_path / "scene"
    replace(make_scene(12, 16), object_mesh=MESH, ground=GROUND).save(folder)
    return folder


def edit(bundle, key, value):
    document = json.loads((bundle / "scene.json").read_text())
    document[key] = value
    (bundle / "scene.json").write_text(json.dumps(document))


def test_mesh_and_floor_come_back_as_they_were(bundle):
    scene = Scene.load(bundle)
    assert scene.ground == GROUND
    np.testing.assert_array_equal(scene.object_mesh.vertices, MESH.vertices)
    np.testing.assert_array_equal(scene.object_mesh.faces, MESH.faces)
    assert json.loads((bundle / "scene.json").read_text())["object_geometry"] == {
        "file": "object_mesh.npz",
        "pose": None,
    }


def test_a_scene_without_them_has_none(tmp_path):
    make_scene(12, 16).save(tmp_path / "scene")
    scene = Scene.load(tmp_path / "scene")
    assert scene.object_mesh is None
    assert scene.ground is None


def test_a_zipped_scene_has_them_too(bundle, tmp_path):
    with zipfile.ZipFile(tmp_path / "scene.zip", "w") as archive:
        for path in bundle.iterdir():
            archive.write(path, path.name)
    assert Scene.load(tmp_path / "scene.zip").object_mesh is not None


def test_a_padded_scene_has_no_geometry():
    scene = replace(make_scene(12, 16), object_mesh=MESH, ground=GROUND)
    assert scene.padded(4).object_mesh is MESH
    grown = scene.padded(10)
    assert (grown.object_mesh, grown.ground) == (None, None)


def test_a_pose_places_the_mesh(bundle):
    pose = [[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 2, -4], [0, 0, 0, 1]]
    edit(bundle, "object_geometry", {"file": "object_mesh.npz", "pose": pose})
    x, y, z = MESH.vertices.T
    wanted = np.stack([0.5 - y, x, 2 * z - 4], axis=1)
    np.testing.assert_allclose(Scene.load(bundle).object_mesh.vertices, wanted, atol=1e-6)


@pytest.mark.parametrize("name", ["object.glb", "object.obj"])
def test_a_model_file_places_the_mesh(bundle, name):
    trimesh = pytest.importorskip("trimesh", reason="model files need the extra `scene`")
    trimesh.Trimesh(MESH.vertices, MESH.faces, process=False).export(bundle / name)
    edit(bundle, "object_geometry", {"file": name})
    got = Scene.load(bundle).object_mesh
    assert len(got.faces) == len(MESH.faces)
    for bound in (np.min, np.max):
        np.testing.assert_allclose(bound(got.vertices, 0), bound(MESH.vertices, 0), atol=1e-5)


@pytest.mark.parametrize(
    ("value", "error", "named"),
    [
        ({"file": "nowhere.npz"}, SceneError, "found no file"),
        ({"file": "background.exr"}, SceneError, "expected a mesh as one of"),
        ({"file": "../object_mesh.npz"}, UnsafePathError, "lies outside the bundle"),
        ({"file": "/etc/passwd.npz"}, UnsafePathError, "lies outside"),
        ({}, SceneError, "missing key 'file'"),
        ({"file": "object_mesh.npz", "pose": [[1, 0], [0, 1]]}, SceneError, "list of 4 values"),
        (
            {"file": "object_mesh.npz", "pose": [[1, 0, 0, 0]] * 4},
            SceneError,
            "last row is 0 0 0 1",
        ),
        (
            {"file": "object_mesh.npz", "pose": [[1e308] * 4] * 3 + [[0, 0, 0, 1]]},
            NonFiniteError,
            "NaN",
        ),
    ],
)
def test_malformed_geometry_is_one_clear_error(bundle, value, error, named):
    edit(bundle, "object_geometry", value)
    with pytest.raises(error, match=named):
        Scene.load(bundle)


@pytest.mark.parametrize(
    ("value", "named"),
    [
        ({"normal": [0, 1, 0]}, "missing key 'offset'"),
        ({"normal": [0, 3, 0], "offset": -1}, "length 1"),
        ({"normal": [0, 1], "offset": -1}, "list of 3 values"),
    ],
)
def test_malformed_ground_names_its_place(bundle, value, named):
    edit(bundle, "ground", value)
    with pytest.raises(SceneError, match=rf"scene\.json\.ground.*{named}"):
        Scene.load(bundle)


@pytest.mark.parametrize("damage", ["empty", "truncated", "foreign", "nameless", "pickle", "text"])
def test_damaged_mesh_files_are_scene_errors(bundle, damage):
    path = bundle / "object_mesh.npz"
    if damage == "empty":
        path.write_bytes(b"")
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:-200])
    elif damage == "foreign":
        path.write_bytes(b"\x89PNG\r\n" * 100)
    elif damage == "nameless":
        np.savez(path, points=MESH.vertices)
    elif damage == "pickle":
        np.savez(path, vertices=np.array([{}], dtype=object), faces=MESH.faces)
    else:
        np.savez(path, vertices=MESH.vertices.astype(str), faces=MESH.faces)
    with pytest.raises(SceneError, match=r"object_mesh\.npz: expected"):
        Scene.load(bundle)


@pytest.mark.parametrize("name", ["object.glb", "object.ply"])
def test_damaged_model_files_are_scene_errors(bundle, name):
    pytest.importorskip("trimesh", reason="model files need the extra `scene`")
    (bundle / name).write_bytes(b"glTF\x02\x00\x00\x00 and then nothing that makes sense")
    edit(bundle, "object_geometry", {"file": name})
    with pytest.raises(SceneError, match="cannot be read as a model"):
        Scene.load(bundle)


def test_a_bomb_is_refused_before_it_unpacks(bundle, monkeypatch):
    monkeypatch.setattr("spotlight_runtime.geometry.mesh_files.MAX_MESH_BYTES", 1000)
    with pytest.raises(SceneError, match="more than the limit of 1000"):
        Scene.load(bundle)


def test_other_number_types_are_converted(bundle):
    np.savez(
        bundle / "object_mesh.npz",
        vertices=MESH.vertices.astype(np.float64),
        faces=MESH.faces.astype(np.uint64),
    )
    mesh = Scene.load(bundle).object_mesh
    assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float32, np.int32)


def test_faces_beyond_any_vertex_do_not_wrap_round(bundle):
    faces = MESH.faces.astype(np.int64)
    faces[3, 1] += 2**32
    np.savez(bundle / "object_mesh.npz", vertices=MESH.vertices, faces=faces)
    with pytest.raises(InvalidInputError, match=r"object_mesh\.npz.*expected rows of"):
        Scene.load(bundle)


@pytest.mark.parametrize(
    ("vertices", "faces", "error", "named"),
    [
        (np.zeros((0, 3), np.float32), MESH.faces, ShapeError, "is the model empty"),
        (MESH.vertices, np.zeros((0, 3), np.int32), ShapeError, "is the model empty"),
        (MESH.vertices.astype(np.float64), MESH.faces, DtypeError, "float32"),
        (MESH.vertices, MESH.faces.astype(np.int64), DtypeError, "int32"),
        (MESH.vertices.tolist(), MESH.faces, DtypeError, "got list"),
        (MESH.vertices[:, :2], MESH.faces, ShapeError, "shape"),
        (np.where(MESH.vertices > 0.3, np.nan, MESH.vertices), MESH.faces, NonFiniteError, "NaN"),
        (MESH.vertices, MESH.faces - 1, InvalidInputError, "from -1"),
        (np.ones((9, 3), np.float32), MESH.faces % 9, InvalidInputError, "in one point"),
        (MESH.vertices[:-1], MESH.faces, InvalidInputError, "expected rows of"),
    ],
)
def test_impossible_meshes_are_named(vertices, faces, error, named):
    with pytest.raises(error, match=named):
        ObjectMesh(vertices, faces)
