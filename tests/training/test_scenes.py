"""Scene descriptions: reproducible, disjoint between splits, and sound as stages."""

import itertools

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the data renderer needs the training packages")

from spotlight_training.render import kinds
from spotlight_training.render.description import SceneDescription, direction, project
from spotlight_training.render.scenes import SceneOptions, describe, item_extent
from spotlight_training.render.staging import corners

SEEDS = range(12)


def test_same_seed_gives_an_equal_description_and_another_seed_does_not():
    assert describe("train", 3) == describe("train", 3)
    assert describe("train", 3) != describe("train", 4)
    assert describe("train", 3) != describe("test", 3)


@pytest.mark.parametrize("split", kinds.SPLITS)
def test_json_round_trip_keeps_every_digit(split):
    scene = describe(split, 5)
    assert SceneDescription.from_json(scene.to_json()) == scene


def test_another_format_version_is_refused_with_its_remedy():
    text = describe("train", 0).to_json().replace('"version":1', '"version":0', 1)
    with pytest.raises(ValueError, match=r"expected format version 1, got 0\. Render"):
        SceneDescription.from_json(text)


def test_splits_share_neither_object_kinds_nor_panoramas_with_training():
    for one, other in itertools.combinations(kinds.SPLITS, 2):
        assert not set(kinds.OBJECT_KINDS[one]) & set(kinds.OBJECT_KINDS[other])
    for held_out in ("val", "test"):
        assert not set(kinds.HDRIS["train"]) & set(kinds.HDRIS[held_out])
    for split in kinds.SPLITS:
        for seed in SEEDS:
            scene = describe(split, seed)
            assert scene.subject.kind in kinds.OBJECT_KINDS[split]
            assert scene.ambient.name in ("", *kinds.HDRIS[split])


def test_no_hdris_leaves_gradient_skies_only():
    options = SceneOptions(use_hdris=False)
    assert {describe("train", seed, options).ambient.kind for seed in SEEDS} == {"sky"}


@pytest.mark.parametrize("seed", SEEDS)
def test_lights_hang_inside_the_walls_in_the_direction_they_name(seed):
    scene = describe("train", seed)
    extent = item_extent(
        scene.subject.kind, scene.subject.seed, scene.subject.size, scene.subject.yaw, {}
    )
    middle = np.array([0.0, 0.0, scene.support_height + extent[2] / 2])
    for light in scene.lights:
        offset = np.asarray(light.position) - middle
        np.testing.assert_allclose(
            offset, light.distance * direction(light.azimuth, light.elevation), atol=1e-9
        )
        assert 15.0 <= light.elevation <= 75.0
        assert light.position[2] > light.radius
        for wall in scene.walls:
            reach = float(direction(wall.azimuth, 0.0) @ light.position) + light.radius
            assert reach < wall.distance


@pytest.mark.parametrize("split", kinds.SPLITS)
def test_the_object_is_in_frame_at_the_promised_size(split):
    for seed in SEEDS:
        scene = describe(split, seed)
        item = scene.subject
        extent = item_extent(item.kind, item.seed, item.size, item.yaw, {})
        middle = np.array([0.0, 0.0, scene.support_height + extent[2] / 2])
        frame = project(scene.camera, corners(extent, middle))
        assert frame[:, 2].min() > 0
        # The corners of a box stick out further than what is in it.
        assert frame[:, :2].min() > -0.03
        assert frame[:, :2].max() < 1.03
        assert np.ptp(frame[:, 1]) < 0.6
        for wall in scene.walls:
            assert direction(wall.azimuth, 0.0) @ scene.camera.position < wall.distance


def test_evaluation_scenes_have_eight_azimuths_a_truth_and_its_opposite():
    lights = {
        light.name: light for light in describe("test", 1, SceneOptions(evaluation=True)).lights
    }
    assert [lights[f"{i:04d}"].azimuth for i in range(8)] == [0, 45, 90, 135, 180, 225, 270, 315]
    assert {lights[f"{i:04d}"].elevation for i in range(8)} == {45.0}
    turn = (lights["gt_dir_opposite"].azimuth - lights["gt_dir"].azimuth) % 360
    assert turn == pytest.approx(180.0)
    assert lights["gt_dir_opposite"].elevation == lights["gt_dir"].elevation


def test_azimuth_follows_the_published_convention():
    np.testing.assert_allclose(direction(0.0, 0.0), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(direction(90.0, 0.0), [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(direction(0.0, 90.0), [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(("split", "seed"), [("training", 0), ("train", -1)])
def test_unknown_split_and_negative_seed_are_refused(split, seed):
    with pytest.raises(ValueError, match="expected"):
        describe(split, seed)


def test_external_objects_belong_to_one_split_by_their_names():
    names = ("chair.glb", "chair/chair.gltf", "car.obj", "duck/scene.gltf")
    options = SceneOptions(file_extents=dict.fromkeys(names, (0.4, 0.4, 0.4)))
    drawn = {
        split: {describe(split, seed, options).subject.kind for seed in range(24)}
        for split in kinds.SPLITS
    }
    assert {
        split: {kind for kind in found if kind.startswith("file:")}
        for split, found in drawn.items()
    } == {
        "train": {"file:chair.glb", "file:chair/chair.gltf"},
        "val": {"file:car.obj"},
        "test": {"file:duck/scene.gltf"},
    }


def test_a_split_without_external_objects_is_named():
    options = SceneOptions(file_extents={"chair.glb": (0.4, 0.4, 0.4)})
    with pytest.raises(ValueError, match=r"split 'val' by .*, got train 1, val 0, test 0\. Add"):
        describe("val", 0, options)
