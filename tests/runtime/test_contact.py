"""Footprints and what hides the object, against geometry known exactly."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.models import box_arrays
from support.rooms import HEIGHT, room

from spotlight_runtime.composing.materials import Material
from spotlight_runtime.composing.posing import Placement
from spotlight_runtime.composing.product import Piece, assemble

pytest.importorskip("embreex", reason="ray casting needs the extra scene")

from spotlight_runtime.composing.contact import footprint_depth, visible_share
from spotlight_runtime.composing.gbuffer import render_gbuffer
from spotlight_runtime.composing.posing import pose_product

BACKDROP = room(240, 180)
CAMERA, GROUND = BACKDROP.photograph.camera, BACKDROP.ground


def standing(sides, at=(0.5, 0.65), **placement):
    vertices, faces = box_arrays(sides)
    product = assemble([Piece(vertices, faces, Material())], "box")
    return pose_product(product, Placement(at, **placement), CAMERA, GROUND)


def test_footprint_is_the_floor_under_the_box():
    posed = standing((0.8, 0.5, 0.8), yaw=20.0)
    depth = footprint_depth(posed, CAMERA, GROUND)
    touching = depth > 0.0
    np.testing.assert_allclose(depth[touching], BACKDROP.maps.depth[touching], rtol=1e-4)
    points = CAMERA.unproject(BACKDROP.maps.depth) @ GROUND.world_axes().T.astype(np.float32)
    base = posed.vertices @ GROUND.world_axes().T.astype(np.float32)
    low = base[np.abs(base[:, 2] + HEIGHT) < 1e-3]
    centre = np.unique(low.round(4), axis=0).mean(axis=0)
    turn = np.radians(20.0)
    local = (points - centre)[..., :2] @ np.array(
        [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    )
    under = (np.abs(local) < 0.4).all(axis=-1) & (np.abs(points[..., 2] + HEIGHT) < 1e-3)
    overlap = (under & touching).sum() / (under | touching).sum()
    assert under.sum() > 100
    assert overlap > 0.95


def test_legs_touch_and_the_space_between_does_not():
    vertices, faces = box_arrays((0.1, 0.5, 0.1))
    top, top_faces = box_arrays((0.9, 0.05, 0.9))
    legs = [
        Piece(vertices + np.float32([x, 0, z]), faces, Material())
        for x in (-0.4, 0.4)
        for z in (-0.4, 0.4)
    ]
    pieces = [Piece(top + np.float32([0, 0.5, 0]), top_faces, Material()), *legs]
    table = pose_product(assemble(pieces, "table"), Placement((0.5, 0.65)), CAMERA, GROUND)
    touching = (footprint_depth(table, CAMERA, GROUND) > 0.0).astype(np.uint8)
    assert cv2.connectedComponents(touching)[0] - 1 == 4


def test_a_point_thinner_than_a_pixel_still_touches():
    tip = np.float32([[0, 0, 0], [0.5, 1, 0], [-0.5, 1, 0.001], [0, 1, 0.5]])
    faces = np.int32([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 2, 3]])
    product = assemble([Piece(tip, faces, Material())], "top")
    posed = pose_product(product, Placement((0.5, 0.65), size=0.02), CAMERA, GROUND)
    depth = footprint_depth(posed, CAMERA, GROUND)
    assert (depth > 0).sum() >= 1
    row, column = np.argwhere(depth > 0)[0]
    assert (column + 0.5) / 240 == pytest.approx(0.5, abs=0.01)
    assert (row + 0.5) / 180 == pytest.approx(0.65, abs=0.01)


def test_contact_outside_the_picture_is_none():
    posed = standing((3.0, 0.4, 0.2), at=(0.98, 0.98))
    moved = posed.vertices + np.float32([6.0, 0.0, 0.0])
    assert footprint_depth(replace(posed, vertices=moved), CAMERA, GROUND).max() == 0.0


def share_of(posed, backdrop):
    buffer = render_gbuffer(posed, CAMERA)
    top, bottom, left, right = buffer.box
    crop = np.s_[top:bottom, left:right]
    share = visible_share(
        buffer.maps.depth[crop],
        buffer.mask[crop],
        backdrop.maps.depth[crop],
        CAMERA,
        GROUND,
        buffer.box,
    )
    return share, buffer.mask[crop]


def test_floor_and_wall_hide_nothing_even_where_depth_is_wrong():
    posed = standing((0.8, 0.9, 0.8), yaw=20.0)
    for factor in (1.0, 0.985, 1.02):
        depth = BACKDROP.maps.depth * np.float32(factor)
        wrong = replace(BACKDROP, maps=replace(BACKDROP.maps, depth=depth))
        share, _ = share_of(posed, wrong)
        np.testing.assert_array_equal(share, 1.0)


def test_screen_in_front_hides_and_screen_behind_does_not():
    posed = standing((0.8, 0.9, 0.8))
    share, mask = share_of(posed, room(240, 180, block=(-5.0, 0.0, 1.2)))
    columns = np.arange(mask.shape[1])
    hidden = (share == 0.0) & (mask == 1.0)
    assert hidden.any()
    left = render_gbuffer(posed, CAMERA).box[2]
    assert (columns[hidden.any(axis=0)] + left).max() < 121
    assert share[:, columns + left > 123].min() == 1.0
    behind, _ = share_of(posed, room(240, 180, block=(-5.0, 5.0, 5.0)))
    np.testing.assert_array_equal(behind, 1.0)


def test_hidden_rim_is_antialiased():
    posed = standing((0.8, 0.9, 0.8))
    share, _ = share_of(posed, room(240, 180, block=(-5.0, 0.0, 1.2)))
    assert ((share > 0.0) & (share < 1.0)).any()
