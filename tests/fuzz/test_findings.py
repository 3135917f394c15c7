"""What fuzzing and looking for it found, mended: each file that once did more than be refused."""

import json
import struct
import zipfile

import numpy as np
import OpenEXR
import pytest
from support.scenes import make_scene

pytest.importorskip("trimesh", reason="models need the extra scene")
pytest.importorskip("embreex", reason="models need the extra scene")

from fuzz import seeds
from fuzz.guard import peak_memory
from spotlight_runtime import Scene, read_image, write_image
from spotlight_runtime.composing.cutout import read_cutout
from spotlight_runtime.errors import (
    ImageFileError,
    InvalidInputError,
    ModelIntegrityError,
    NonFiniteError,
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
        read_lights(folder / "a.json", mask)


@pytest.mark.parametrize("name", ["a\0b.png", LONG + ".png"])
def test_shadow_with_a_name_no_file_can_have(tmp_path, name):
    (tmp_path / "a.json").write_text(json.dumps([{"shadow": name}]))
    with pytest.raises((InvalidInputError, ImageFileError)):
        read_lights(tmp_path / "a.json", np.zeros((8, 8), np.float32))


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
