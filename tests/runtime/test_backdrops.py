"""The floor found or given, depth in metres, and maps that users bring."""

from dataclasses import replace

import numpy as np
import pytest
from support.rooms import HEIGHT, PITCH, room

from spotlight_runtime import write_image
from spotlight_runtime.composing.backdrop import build_backdrop, combine_maps, read_map
from spotlight_runtime.errors import (
    GroundError,
    InvalidInputError,
    MissingMapError,
    NonFiniteError,
    ShapeError,
)
from spotlight_runtime.scenes.scene import Intrinsics

ROOM = room()


def same_ground(found, wanted, degrees=0.5, share=0.01):
    cosine = float(np.dot(found.normal, wanted.normal))
    assert np.degrees(np.arccos(min(cosine, 1.0))) < degrees
    assert found.offset == pytest.approx(wanted.offset, rel=share)


def test_floor_is_found_in_the_maps():
    same_ground(build_backdrop(ROOM.photograph, ROOM.maps).ground, ROOM.ground)


@pytest.mark.parametrize("unit", [0.01, 1.0, 37.0])
def test_camera_height_gives_the_scale(unit):
    maps = replace(ROOM.maps, depth=ROOM.maps.depth * np.float32(unit))
    backdrop = build_backdrop(ROOM.photograph, maps, camera_height=HEIGHT)
    same_ground(backdrop.ground, ROOM.ground)
    np.testing.assert_allclose(backdrop.maps.depth, ROOM.maps.depth, rtol=0.01)
    twice = build_backdrop(ROOM.photograph, maps, camera_height=2 * HEIGHT)
    np.testing.assert_allclose(twice.maps.depth, 2 * ROOM.maps.depth, rtol=0.01)


HORIZON = 0.5 - ROOM.photograph.camera.focal * np.tan(np.radians(PITCH)) / 120


@pytest.mark.parametrize("height", [None, HEIGHT])
@pytest.mark.parametrize("unit", [1.0, 5.0])
def test_horizon_and_contact_place_the_floor(height, unit):
    if height is None and unit != 1.0:
        unit = 1.0  # without a height the depth is in metres
    maps = replace(ROOM.maps, depth=ROOM.maps.depth * np.float32(unit))
    backdrop = build_backdrop(
        ROOM.photograph, maps, contact=(0.4, 0.9), horizon=HORIZON, camera_height=height
    )
    same_ground(backdrop.ground, ROOM.ground, share=0.03)
    np.testing.assert_allclose(backdrop.maps.depth, ROOM.maps.depth, rtol=0.03)


def test_horizon_needs_a_contact_below_it():
    with pytest.raises(InvalidInputError, match="contact point"):
        build_backdrop(ROOM.photograph, ROOM.maps, horizon=0.2)
    with pytest.raises(GroundError, match="below the horizon"):
        build_backdrop(ROOM.photograph, ROOM.maps, contact=(0.5, 0.1), horizon=0.2)


def test_no_floor_names_the_remedy():
    size = ROOM.maps.depth.shape
    wall = replace(
        ROOM.maps,
        depth=np.full(size, 3.0, np.float32),
        normal=np.broadcast_to(np.float32([0, 0, 1]), (*size, 3)).copy(),
    )
    with pytest.raises(GroundError, match=r"no floor found.*--horizon 0\.4.*--at"):
        build_backdrop(ROOM.photograph, wall)


def test_unknown_depth_at_the_contact_and_no_depth_at_all():
    nothing = replace(ROOM.maps, depth=np.zeros_like(ROOM.maps.depth))
    with pytest.raises(GroundError, match="contact point"):
        build_backdrop(ROOM.photograph, nothing, contact=(0.5, 0.9), horizon=0.3)
    with pytest.raises(MissingMapError, match="--depth"):
        build_backdrop(ROOM.photograph, replace(ROOM.maps, depth=None))


@pytest.mark.parametrize("height", [0.0, -1.0, np.nan, np.inf])
def test_impossible_camera_height(height):
    with pytest.raises(InvalidInputError, match="camera height"):
        build_backdrop(ROOM.photograph, ROOM.maps, camera_height=height)


def test_given_maps_go_before_estimated_ones():
    estimated = Intrinsics(ROOM.maps.albedo, ROOM.maps.normal, ROOM.maps.depth)
    mine = np.full_like(ROOM.maps.depth, 2.0)
    maps = combine_maps({"depth": mine}, estimated)
    assert maps.depth is mine
    assert maps.albedo is estimated.albedo
    assert maps.roughness is None


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ({}, "--albedo --normal --depth"),
        ({"albedo": ROOM.maps.albedo}, "--normal --depth"),
        ({"albedo": ROOM.maps.albedo, "normal": ROOM.maps.normal}, "--depth"),
    ],
)
def test_missing_maps_are_named(given, missing):
    with pytest.raises(MissingMapError, match=rf"give {missing}, or a model"):
        combine_maps(given, None)


def test_maps_are_read_as_their_files_say(tmp_path, rng):
    colour = rng.random((30, 40, 3), dtype=np.float32)
    write_image(tmp_path / "a.exr", colour)
    np.testing.assert_array_equal(read_map(tmp_path / "a.exr", "albedo", (30, 40)), colour)
    write_image(tmp_path / "grey.png", np.full((30, 40, 3), 0.5, np.float32), bits=16)
    albedo = read_map(tmp_path / "grey.png", "albedo", (30, 40))
    np.testing.assert_allclose(albedo, 0.2140, atol=1e-3)
    normal = rng.normal(size=(30, 40, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    write_image(tmp_path / "n.png", 0.5 + 0.5 * normal, bits=16)
    write_image(tmp_path / "n.exr", normal)
    for name in ("n.png", "n.exr"):
        found = read_map(tmp_path / name, "normal", (30, 40))
        np.testing.assert_allclose(found, normal, atol=1e-4)
    write_image(tmp_path / "d.png", np.full((30, 40), 0.25, np.float32), bits=16)
    depth = read_map(tmp_path / "d.png", "depth", (30, 40), 20.0)
    np.testing.assert_allclose(depth, 5.0, rtol=1e-4)
    assert depth.shape == (30, 40)


def test_smaller_maps_are_enlarged_and_normals_stay_unit(tmp_path, rng):
    normal = rng.normal(size=(15, 20, 3)).astype(np.float32)
    write_image(tmp_path / "n.exr", normal)
    found = read_map(tmp_path / "n.exr", "normal", (60, 80))
    assert found.shape == (60, 80, 3)
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1.0, atol=1e-4)
    write_image(tmp_path / "d.exr", np.full((15, 20), 3.0, np.float32))
    np.testing.assert_allclose(read_map(tmp_path / "d.exr", "depth", (60, 80)), 3.0)


def test_map_of_another_picture_grey_or_not_finite(tmp_path):
    write_image(tmp_path / "d.exr", np.ones((15, 15), np.float32))
    with pytest.raises(ShapeError, match=r"expected the photograph's shape, 80×60"):
        read_map(tmp_path / "d.exr", "depth", (60, 80))
    with pytest.raises(ShapeError, match="3 channels in the albedo map"):
        read_map(tmp_path / "d.exr", "albedo", (15, 15))
    write_image(tmp_path / "d.exr", np.full((15, 15), np.nan, np.float32))
    with pytest.raises(NonFiniteError, match="depth map holds NaN"):
        read_map(tmp_path / "d.exr", "depth", (15, 15))
