"""Test sets in the published layout, and what is said of those that are not."""

import shutil

import numpy as np
import pytest
from support.scenes import make_scene

from bench.published import AZIMUTHS, lit
from spotlight_bench.dataset import find_scenes, fingerprint, has_directions, load_scene
from spotlight_bench.errors import DataError
from spotlight_bench.evaluate import plan
from spotlight_runtime import write_image
from spotlight_runtime.imaging.colour import linear_to_srgb


@pytest.fixture
def broken(scene_folder, tmp_path):
    """A copy of a scene to break."""
    return shutil.copytree(scene_folder, tmp_path / "set" / scene_folder.name)


def test_a_scene_has_shadows_and_truths_of_nine_directions(scene_folder):
    test = load_scene(scene_folder, ("gt_dir", *AZIMUTHS))
    assert test.name == "room_0"
    assert [d.name for d in test.directions] == ["gt_dir", *AZIMUTHS]
    assert len(test.truths) == 8
    scene = make_scene(64, 64, 0)
    np.testing.assert_allclose(test.truths[3], linear_to_srgb(lit(scene, 3)), atol=1e-5)
    np.testing.assert_allclose(test.directions[0].truth, linear_to_srgb(lit(scene, 1)), atol=1e-5)
    for one in test.directions:
        assert one.shadow.shape == one.opposite.shape == (64, 64)
        assert not np.array_equal(one.shadow, one.opposite)


def test_directions_that_are_not_asked_for_are_not_read(scene_folder):
    test = load_scene(scene_folder, ("gt_dir",))
    assert test.truths is None


def test_scenes_are_found_below_a_folder_or_named_themselves(testset, scene_folder):
    assert [f.name for f in find_scenes(testset)] == ["room_0", "room_1"]
    assert find_scenes(scene_folder) == (scene_folder,)


def test_a_folder_without_scenes_says_how_to_come_by_some(tmp_path):
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DataError, match=r"export-testset.*testset"):
            find_scenes(folder)


def test_a_fingerprint_tells_sets_of_the_same_names_apart(testset, tmp_path):
    copy = shutil.copytree(testset, tmp_path / "elsewhere")
    found = [fingerprint(testset)]
    assert fingerprint(copy) == found[0]
    file = copy / "room_1" / "shadow_positive_0000.png"
    size = file.stat().st_size
    file.write_bytes(bytes(size))
    found.append(fingerprint(copy))
    file.write_bytes(bytes(size + 1))
    found.append(fingerprint(copy))
    file.rename(file.with_name("other.png"))
    found.append(fingerprint(copy))
    shutil.rmtree(file.parent)
    found.append(fingerprint(copy))
    assert len(set(found)) == len(found)


def test_a_missing_shadow_is_named(broken):
    (broken / "shadow_positive_0003.png").unlink()
    with pytest.raises(DataError, match=r"shadow_positive_0003\.png"):
        load_scene(broken, tuple(AZIMUTHS))
    assert not has_directions(broken, tuple(AZIMUTHS))
    assert has_directions(broken, ("gt_dir",))


def test_a_missing_opposite_shadow_is_none(broken):
    (broken / "shadow_negative_0003.png").unlink()
    assert load_scene(broken, ("0003",)).directions[0].opposite is None


def test_a_missing_truth_is_none(broken):
    (broken / "truth_0003.exr").unlink()
    test = load_scene(broken, tuple(AZIMUTHS))
    assert test.directions[3].truth is None
    assert test.truths is None


@pytest.mark.parametrize("name", ["shadow_negative_0000.png", "truth_0000.exr"])
def test_another_size_is_named(broken, name):
    write_image(broken / name, np.zeros((32, 64, 3), np.float32))
    with pytest.raises(DataError, match=rf"{name}.*64x64.*32"):
        load_scene(broken, ("0000",))


def test_a_coloured_shadow_is_taken_for_its_brightness(broken):
    grey = np.full((64, 64, 3), 0.5, np.float32)
    write_image(broken / "shadow_positive_0000.png", grey)
    shadow = load_scene(broken, ("0000",)).directions[0].shadow
    np.testing.assert_allclose(shadow, 0.5, atol=0.01)


def test_a_plan_counts_both_kinds_of_scenes(testset, broken):
    work = plan(testset, None, 1, 1)
    assert [(w.folder.name, len(w.directions), w.keep_images) for w in work] == [
        ("room_0", 9, True),
        ("room_1", 1, False),
    ]
    assert [w.directions for w in plan(testset, 0, 1, 0)] == [tuple(AZIMUTHS)]
    (broken / "shadow_positive_0003.png").unlink()
    assert [w.directions for w in plan(broken.parent, None, 30, 0)] == [("gt_dir",)]
    (broken / "shadow_positive_gt_dir.png").unlink()
    with pytest.raises(DataError, match="found neither"):
        plan(broken.parent, None, 30, 0)
