"""The floor of a photograph whose depth is a guess: upright edges, and depth settled on it."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.rooms import HEIGHT, oracle_network, room, room_ground

from spotlight_runtime.composing.backdrop import CAMERA_HEIGHT, build_backdrop
from spotlight_runtime.composing.estimator import estimate_intrinsics
from spotlight_runtime.composing.photograph import (
    Photograph,
    crop_panorama,
    expose,
    read_photograph,
)
from spotlight_runtime.composing.settling import settle
from spotlight_runtime.composing.verticals import up_from_verticals
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground

REAL = Path(__file__).parents[2].parent / "shared/real"


def posts(pitch, roll=0.0, clutter=0, size=(480, 640), field_of_view=60.0, count=9):
    """Dark posts in front of a bright wall, seen by a camera that is tilted and rolled."""
    camera = Camera(size[1], size[0], field_of_view)
    p, r = np.radians([pitch, roll])
    up = np.array([np.sin(r), np.cos(r) * np.cos(p), np.cos(r) * np.sin(p)])
    picture = np.full((*size, 3), 0.7, np.float32)
    right = np.cross(up, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    away = np.cross(up, right)
    ends = []
    for x in np.linspace(-2.0, 2.0, count):
        foot = x * right + 4.0 * away - 1.4 * up
        ends.append(camera.project(np.stack([foot, foot + 2.2 * up]))[:, :2])
    rng = np.random.default_rng(1)
    for _ in range(clutter):
        start = rng.uniform([0, 0], size[::-1])
        ends.append(np.stack([start, start + rng.normal(size=2) * 80]))
    for pair in ends:
        a, b = (tuple(round(v * 16) for v in end) for end in pair)
        cv2.line(picture, a, b, (0.1, 0.1, 0.1), 3, cv2.LINE_AA, 4)
    return Photograph(picture, field_of_view), up


def degrees(found, wanted):
    return np.degrees(np.arccos(np.clip(np.dot(found, wanted), -1.0, 1.0)))


@pytest.mark.parametrize("pitch", [-10.0, 5.0, 20.0, 35.0])
@pytest.mark.parametrize("roll", [-4.0, 0.0])
@pytest.mark.parametrize("clutter", [0, 25])
def test_posts_say_which_way_is_up(pitch, roll, clutter):
    photograph, up = posts(pitch, roll, clutter)
    assert degrees(up_from_verticals(photograph), up) < 1.0


def test_large_photographs_and_other_lenses_say_the_same():
    for size, field_of_view in (((1500, 2000), 60.0), ((480, 640), 35.0)):
        photograph, up = posts(12.0, 1.0, size=size, field_of_view=field_of_view)
        assert degrees(up_from_verticals(photograph), up) < 1.0


@pytest.mark.parametrize("kind", ["blank", "noise", "clutter", "few", "level"])
def test_without_upright_edges_there_is_no_answer(kind, rng):
    if kind == "blank":
        photograph = Photograph(np.full((480, 640, 3), 0.5, np.float32))
    elif kind == "noise":
        photograph = Photograph(rng.random((480, 640, 3), dtype=np.float32))
    elif kind == "clutter":
        photograph, _ = posts(10.0, clutter=25, count=0)
    elif kind == "few":
        photograph, _ = posts(10.0, count=1)
    else:
        picture = np.full((480, 640, 3), 0.7, np.float32)
        picture[::40] = 0.1
        photograph = Photograph(picture)
    assert up_from_verticals(photograph) is None


@pytest.mark.real
@pytest.mark.skipif(not REAL.is_dir(), reason="needs ../shared/real beside the repository")
def test_views_of_real_panoramas_say_how_they_were_cut():
    camera = Camera(640, 480, 60.0)
    errors, asked = [], 0
    for name in ("esplanade", "lab", "workshop", "empty_warehouse_01_1k"):
        panorama = read_photograph(REAL / f"hdr/{name}.hdr", exposure=0.0)
        for yaw, pitch in ((0, -10), (120, -25), (240, -10)):
            view = crop_panorama(panorama, yaw, pitch, camera)
            up = up_from_verticals(Photograph(expose(view.radiance), 60.0))
            asked += 1
            if up is not None:
                errors.append(degrees(up, room_ground(pitch=-pitch).normal))
    assert len(errors) >= 0.8 * asked
    assert np.median(errors) < 1.0
    assert max(errors) < 4.0


ROOM = room(320, 240, block=(-1.5, -0.5, 3.0))
CAMERA = ROOM.photograph.camera


@pytest.mark.parametrize(("scale", "power"), [(1.0, 1.0), (30.0, 1.0), (2.0, 0.6), (0.5, 1.4)])
def test_settling_undoes_a_scale_and_a_power(scale, power):
    bent = replace(ROOM.maps, depth=np.float32(scale) * ROOM.maps.depth ** np.float32(power))
    settled = settle(bent, CAMERA, ROOM.ground)
    np.testing.assert_allclose(settled.depth, ROOM.maps.depth, rtol=0.02)
    np.testing.assert_allclose(settled.normal, ROOM.maps.normal, atol=0.02)
    assert settled.albedo is ROOM.maps.albedo


def test_wobbly_floor_becomes_flat_and_what_stands_stays(rng):
    wobble = cv2.GaussianBlur(rng.normal(size=(240, 320)).astype(np.float32), (0, 0), 8)
    wobble *= np.float32(0.06) / wobble.std()
    tilt = cv2.GaussianBlur(rng.normal(size=(240, 320, 3)).astype(np.float32), (0, 0), 8) * 2
    normal = ROOM.maps.normal + tilt
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    maps = replace(ROOM.maps, depth=ROOM.maps.depth * np.exp(wobble), normal=normal)
    settled = settle(maps, CAMERA, ROOM.ground)
    floor = ROOM.maps.normal @ np.float32(ROOM.ground.normal) > 0.99
    before = np.abs(np.log(maps.depth / ROOM.maps.depth))[floor]
    after = np.abs(np.log(settled.depth / ROOM.maps.depth))[floor]
    assert np.median(after) < 1e-3 < 0.02 < np.median(before)
    standing = np.abs(np.log(settled.depth / maps.depth))[~floor]
    assert np.median(standing) < 0.05
    np.testing.assert_allclose(np.linalg.norm(settled.normal, axis=2), 1.0, atol=1e-3)


def test_nothing_is_below_the_floor():
    """A guess that puts half of the floor far away and on edge is corrected by the other half."""
    truth = room(320, 240).maps
    maps = replace(truth, depth=truth.depth.copy(), normal=truth.normal.copy())
    maps.depth[150:, :160] *= 3.0
    maps.normal[150:, :160] = [0.0, 0.0, 1.0]
    settled = settle(maps, CAMERA, ROOM.ground)
    np.testing.assert_allclose(settled.depth[150:], truth.depth[150:], rtol=0.02)
    np.testing.assert_allclose(settled.normal[150:], truth.normal[150:], atol=0.02)


def test_table_above_the_floor_is_not_the_floor():
    lifted = room_ground(0.7)  # nearer to the camera: the plane of a table
    full = room(320, 240)
    depth = full.maps.depth.copy()
    rays = CAMERA.rays() @ np.float32(lifted.normal)
    table = np.where(rays < 0, lifted.offset / np.minimum(rays, -1e-6), np.inf).astype(np.float32)
    depth[160:, 200:] = table[160:, 200:]
    settled = settle(replace(full.maps, depth=depth), CAMERA, full.ground)
    np.testing.assert_allclose(settled.depth[170:, 210:], table[170:, 210:], rtol=0.02)


def test_picture_without_floor_is_brought_to_scale_alone():
    wall = replace(
        ROOM.maps,
        depth=np.full((240, 320), 7.0, np.float32),
        normal=np.broadcast_to(np.float32([0, 0, 1]), (240, 320, 3)).copy(),
    )
    settled = settle(wall, CAMERA, ROOM.ground)
    assert settled.depth[:40].std() == pytest.approx(0.0, abs=1e-4)
    assert (settled.depth <= settled.depth[0, 0] + 1e-4).all()  # in front of the wall is floor
    above = settle(wall, CAMERA, Ground((0.0, -0.6, -0.8), -HEIGHT))  # no ray falls
    assert np.isfinite(above.depth).all()


def test_estimated_backdrop_takes_upright_edges_horizon_or_depth():
    """The room has no posts; with posts drawn into its picture they decide."""
    maps = estimate_intrinsics(oracle_network(ROOM, unit=3.0), ROOM.photograph)
    found = build_backdrop(ROOM.photograph, maps, estimated=True)
    assert -found.ground.offset == CAMERA_HEIGHT
    assert degrees(found.ground.normal, ROOM.ground.normal) < 4.0
    assert np.median(np.abs(np.log(found.maps.depth / ROOM.maps.depth))) < 0.05
    camera = ROOM.photograph.camera
    horizon = 0.5 - camera.focal * np.tan(np.radians(15.0)) / camera.height
    told = build_backdrop(
        ROOM.photograph, maps, estimated=True, contact=(0.5, 0.9), horizon=horizon
    )
    assert told.source == "horizon"
    assert degrees(told.ground.normal, ROOM.ground.normal) < 0.01
    photograph, up = posts(15.0, size=(240, 320))
    seen = build_backdrop(photograph, maps, estimated=True, camera_height=2.0)
    assert seen.source == "upright edges"
    assert degrees(seen.ground.normal, up) < 1.0
    assert seen.ground.offset == -2.0
    smooth = Photograph(np.full((240, 320, 3), 0.5, np.float32), 60.0)
    guessed = build_backdrop(smooth, maps, estimated=True)
    assert guessed.source == "depth"
    assert degrees(guessed.ground.normal, ROOM.ground.normal) < 4.0
