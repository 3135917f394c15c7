"""A zip of a scene, and zips that mean harm."""

import shutil
import struct
import zipfile

import pytest
from support.scenes import make_scene

from runtime.scene_comparison import assert_same_scene
from spotlight_runtime import Scene
from spotlight_runtime.errors import SceneError, SpotLightError, UnsafePathError
from spotlight_runtime.scenes import archive as unzipping


@pytest.fixture
def folder(tmp_path):
    make_scene(12, 16).save(tmp_path / "chair")
    return tmp_path / "chair"


def zip_of(folder, path, prefix=""):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.iterdir()):
            archive.write(file, prefix + file.name)
    return path


@pytest.mark.parametrize("prefix", ["", "chair/"])
def test_zip_of_the_files_or_of_the_folder(folder, tmp_path, prefix):
    archive = zip_of(folder, tmp_path / "chair.zip", prefix)
    assert_same_scene(Scene.load(archive), Scene.load(folder))


@pytest.mark.parametrize("prefix", ["", "chair/"])
def test_zip_as_finder_makes_it(folder, tmp_path, prefix):
    archive = zip_of(folder, tmp_path / "chair.zip", prefix)
    with zipfile.ZipFile(archive, "a") as bundle_zip:
        for name in ("._chair", "chair/._scene.json", "chair/._object_mask.png"):
            bundle_zip.writestr(f"__MACOSX/{name}", b"\0\5\x16\7 of a file manager")
        bundle_zip.writestr(f"{prefix}.DS_Store", b"\0\0\0\1Bud1")
        bundle_zip.writestr(".hidden/note.txt", b"")
    assert_same_scene(Scene.load(archive), Scene.load(folder))
    with zipfile.ZipFile(archive) as bundle_zip:
        names = {entry.filename for entry in unzipping.own_entries(bundle_zip)}
    assert names == {prefix + file.name for file in folder.iterdir()}


def test_the_suffix_does_not_matter(folder, tmp_path):
    archive = zip_of(folder, tmp_path / "chair.scene")
    assert Scene.load(str(archive)).size == (12, 16)


def test_nothing_is_left_in_the_temporary_folder(folder, tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    Scene.load(zip_of(folder, tmp_path / "chair.zip"))
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["../evil.txt", "/evil.txt", "a/../../evil.txt", "chair/../../evil.txt"]
)
def test_entry_outside_the_folder_is_refused_before_anything_is_written(folder, tmp_path, name):
    archive = zip_of(folder, tmp_path / "slip.zip")
    with zipfile.ZipFile(archive, "a") as bundle_zip:
        bundle_zip.writestr(name, "evil")
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(UnsafePathError, match=r"slip\.zip: .* lies outside"):
        unzipping.unpack(archive, out)
    assert list(out.iterdir()) == []
    with pytest.raises(UnsafePathError):
        Scene.load(archive)
    assert not list(tmp_path.rglob("evil.txt"))


def test_symlink_in_a_zip_is_not_followed(folder, tmp_path):
    secret = tmp_path / "secret.png"
    shutil.copy(folder / "object_mask.png", secret)
    archive = tmp_path / "link.zip"
    with zipfile.ZipFile(archive, "w") as bundle_zip:
        for file in folder.iterdir():
            if file.name != "object_mask.png":
                bundle_zip.write(file, file.name)
        link = zipfile.ZipInfo("object_mask.png")
        link.external_attr = 0o120777 << 16
        bundle_zip.writestr(link, str(secret))
    with pytest.raises(SpotLightError):
        Scene.load(archive)


def test_bomb_is_refused_before_it_is_unpacked(folder, tmp_path):
    archive = tmp_path / "bomb.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as bundle_zip:
        bundle_zip.writestr("scene.json", "{}")
        bundle_zip.writestr("small.bin", b"\0" * 1000)
    data = archive.read_bytes()
    claimed = struct.pack("<I", unzipping.MAX_ZIP_BYTES)
    # The central directory is what infolist() reads; its sizes come 24 bytes into an entry.
    entry = data.rindex(b"PK\x01\x02")
    archive.write_bytes(data[: entry + 24] + claimed + data[entry + 28 :])
    with pytest.raises(SceneError, match=r"bomb\.zip: unpacks to \d+ bytes, more than the limit"):
        Scene.load(archive)


def test_entry_larger_than_it_claims_is_refused(tmp_path):
    archive = tmp_path / "liar.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as bundle_zip:
        bundle_zip.writestr("scene.json", b"\0" * 100_000)
    data = archive.read_bytes()
    entry = data.rindex(b"PK\x01\x02")
    archive.write_bytes(data[: entry + 24] + struct.pack("<I", 10) + data[entry + 28 :])
    with pytest.raises(SceneError, match=r"liar\.zip"):
        Scene.load(archive)


def test_any_flipped_byte_is_a_scene_or_one_error_of_the_tree(folder, tmp_path):
    archive = zip_of(folder, tmp_path / "chair.zip")
    data = archive.read_bytes()
    flipped = tmp_path / "flipped.zip"
    noticed = 0
    for offset in range(0, len(data), 61):
        spoiled = bytearray(data)
        spoiled[offset] ^= 0xFF
        flipped.write_bytes(spoiled)
        try:
            Scene.load(flipped)
        except SpotLightError:
            noticed += 1
    assert noticed > 10


def test_damaged_directory_is_one_error(folder, tmp_path):
    archive = zip_of(folder, tmp_path / "chair.zip")
    data = archive.read_bytes()
    for start in (data.index(b"PK\x01\x02"), data.rindex(b"PK\x01\x02")):
        archive.write_bytes(data[:start] + b"XXXX" + data[start + 4 :])
        with pytest.raises(SceneError, match=r"chair\.zip"):
            Scene.load(archive)


def test_damaged_content_is_one_error(folder, tmp_path):
    archive = zip_of(folder, tmp_path / "chair.zip")
    data = archive.read_bytes()
    middle = data.index(b"PK\x01\x02") // 2
    archive.write_bytes(data[:middle] + b"\xff" * 64 + data[middle + 64 :])
    with pytest.raises(SceneError, match=r"chair\.zip: cannot be unpacked"):
        Scene.load(archive)


def test_truncated_zip_is_no_scene(folder, tmp_path):
    archive = zip_of(folder, tmp_path / "chair.zip")
    archive.write_bytes(archive.read_bytes()[:-30])
    with pytest.raises(SceneError, match=r"chair\.zip"):
        Scene.load(archive)


@pytest.mark.parametrize("names", [[], ["readme.txt"], ["a/readme.txt"]])
def test_zip_without_a_scene_names_the_zip(tmp_path, names):
    archive = tmp_path / "empty.zip"
    with zipfile.ZipFile(archive, "w") as bundle_zip:
        for name in names:
            bundle_zip.writestr(name, "nothing")
    with pytest.raises(SceneError, match=r"empty\.zip"):
        Scene.load(archive)


def test_encrypted_zip_is_one_error(folder, tmp_path):
    archive = zip_of(folder, tmp_path / "locked.zip")
    data = bytearray(archive.read_bytes())
    for signature, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        start = data.find(signature)
        while start >= 0:
            data[start + flags] |= 1
            start = data.find(signature, start + 1)
    archive.write_bytes(data)
    with pytest.raises(SceneError, match=r"locked\.zip: cannot be unpacked"):
        Scene.load(archive)


def test_file_and_folder_of_one_name_is_one_error(tmp_path):
    archive = tmp_path / "clash.zip"
    with zipfile.ZipFile(archive, "w") as bundle_zip:
        bundle_zip.writestr("a", "file")
        bundle_zip.writestr("a/b", "file in it")
    with pytest.raises(SceneError, match=r"clash\.zip: cannot be unpacked"):
        Scene.load(archive)
