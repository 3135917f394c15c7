"""The maps of shapes whose maps are known: spheres, boxes, planes, and what is thin or clear."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.models import QUAD, QUAD_FACES, QUAD_UV, box_arrays, sphere_arrays

from spotlight_runtime.composing.materials import Material, make_texture
from spotlight_runtime.composing.product import Piece, assemble
from spotlight_runtime.geometry.camera import Camera

pytest.importorskip("embreex", reason="ray casting needs the extra scene")

from spotlight_runtime.composing.gbuffer import render_gbuffer

CAMERA = Camera(160, 120, 50.0)
PLAIN = Material(base_colour=(0.5, 0.25, 0.1, 1.0), roughness=0.6, metallic=0.3)


def moved(vertices, x=0.0, y=0.0, z=0.0):
    return np.add(vertices, [x, y, z]).astype(np.float32)


def quad(scale, z, material=PLAIN, *, x=0.0, y=0.0, uv=QUAD_UV):
    """A quad across the view at a depth of −z."""
    both = np.zeros((4, 2, 2), np.float32)
    both[:, 0] = uv
    return Piece(moved(QUAD * np.float32(scale), x, y, z), QUAD_FACES, material, uv=both)


def solid(buffer):
    return buffer.mask == 1.0


def angles(buffer, wanted, where):
    found = buffer.maps.normal[where] / np.linalg.norm(buffer.maps.normal[where], axis=-1)[:, None]
    return np.degrees(np.arccos(np.clip(np.einsum("nc,nc->n", found, wanted[where]), -1.0, 1.0)))


@pytest.mark.parametrize("centre", [(0.0, 0.0, -3.0), (0.7, -0.4, -4.0), (-1.0, 0.6, -6.0)])
def test_sphere_normals_within_a_degree_and_depth_within_half_a_percent(centre):
    radius = 0.8
    vertices, faces, normals = sphere_arrays(radius)
    sphere = assemble([Piece(moved(vertices, *centre), faces, PLAIN, normals)], "sphere")
    buffer = render_gbuffer(sphere, CAMERA)
    rays = CAMERA.rays().astype(np.float64)
    middle = np.array(centre)
    a = np.einsum("hwc,hwc->hw", rays, rays)
    b = rays @ middle
    discriminant = b * b - a * (middle @ middle - radius**2)
    hit = discriminant > 0.0
    depth = (b - np.sqrt(np.maximum(discriminant, 0.0))) / a
    wanted = (rays * depth[..., None] - middle) / radius
    # Away from the rim, where a pixel's mean over its width is not its middle.
    facing = -np.einsum("hwc,hwc->hw", wanted, rays) / np.sqrt(a)
    inner = solid(buffer) & hit & (facing > 0.3)
    assert inner.sum() > 500
    assert angles(buffer, wanted, inner).max() < 1.0
    assert (np.abs(buffer.maps.depth - depth)[inner] / depth[inner]).max() < 0.005
    coverage = float(buffer.mask.sum())
    assert coverage == pytest.approx(exact_coverage(middle, radius), rel=0.005)


def exact_coverage(middle, radius):
    """Pixels that a sphere covers, counted at 12×12 points each."""
    fine = Camera(CAMERA.width * 12, CAMERA.height * 12, CAMERA.field_of_view)
    rays = fine.rays().astype(np.float64)
    b = rays @ middle
    a = np.einsum("hwc,hwc->hw", rays, rays)
    return float((b * b > a * (middle @ middle - radius**2)).sum()) / 144.0


@given(
    turn=st.floats(0.0, 6.28),
    tilt=st.floats(-0.7, 0.7),
    away=st.floats(3.0, 9.0),
)
@settings(max_examples=10)
def test_box_normals_within_a_degree_and_depth_within_half_a_percent(turn, tilt, away):
    vertices, faces = box_arrays((1.2, 0.9, 0.7))
    about_y = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    )
    rotation = about_x @ about_y
    centre = np.array([0.1, -0.2, -away])
    placed = moved(vertices - [0, 0.45, 0] @ np.eye(3)) @ rotation.T + centre
    box = assemble([Piece(placed.astype(np.float32), faces, PLAIN)], "box")
    buffer = render_gbuffer(box, CAMERA)
    rays = CAMERA.rays().astype(np.float64)
    origin, heading = -centre @ rotation, rays @ rotation
    half = np.array([0.6, 0.45, 0.35])
    with np.errstate(divide="ignore"):
        near = np.minimum((-half - origin) / heading, (half - origin) / heading)
        far = np.maximum((-half - origin) / heading, (half - origin) / heading)
    entry = near.max(axis=-1)
    hit = entry < far.min(axis=-1)
    axis = near.argmax(axis=-1)
    wanted = -np.sign(np.take_along_axis(heading, axis[..., None], -1)) * rotation.T[axis]
    # Where a pixel shows one side only, its depth is that of its middle.
    same = np.pad(axis, 1, mode="edge")
    one_side = np.ones(axis.shape, bool)
    for dy in (0, 1, 2):
        for dx in (0, 1, 2):
            one_side &= same[dy : dy + axis.shape[0], dx : dx + axis.shape[1]] == axis
    inner = solid(buffer) & hit & one_side
    assert inner.sum() > 50
    assert angles(buffer, wanted, inner).max() < 1.0
    assert (np.abs(buffer.maps.depth - entry)[inner] / entry[inner]).max() < 0.005


def test_tilted_plane_depth_and_every_other_map():
    slope = 0.5
    points = QUAD * np.float32([3, 2, 0])
    points[:, 2] = -4.0 - slope * points[:, 0]
    plane = assemble([Piece(points, QUAD_FACES, PLAIN)], "plane")
    buffer = render_gbuffer(plane, CAMERA)
    rays = CAMERA.rays().astype(np.float64)
    depth = 4.0 / (1.0 - slope * rays[..., 0])
    inner = solid(buffer)
    assert inner.mean() > 0.5
    np.testing.assert_allclose(buffer.maps.depth[inner], depth[inner], rtol=1e-3)
    normal = np.array([slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    assert angles(buffer, np.broadcast_to(normal, (*inner.shape, 3)), inner).max() < 0.01
    for value, wanted in (
        (buffer.maps.albedo, (0.5, 0.25, 0.1)),
        (buffer.maps.roughness, 0.6),
        (buffer.maps.metallic, 0.3),
    ):
        np.testing.assert_allclose(value[inner], np.broadcast_to(wanted, value[inner].shape))


def test_edge_pixels_are_covered_by_their_share_and_premultiplied():
    """A vertical edge through the middle of a pixel column covers half of it."""
    pixel = 1.0 / CAMERA.focal
    edge = quad(1.0, -1.0, x=0.5 * pixel - 1.0)
    buffer = render_gbuffer(assemble([edge], "edge"), CAMERA)
    row = buffer.mask[60]
    np.testing.assert_array_equal(row[:80], 1.0)
    assert row[80] == pytest.approx(0.5)
    np.testing.assert_array_equal(row[81:], 0.0)
    np.testing.assert_allclose(buffer.maps.albedo[60, 80], [0.25, 0.125, 0.05], atol=1e-6)
    np.testing.assert_allclose(buffer.maps.normal[60, 80], [0, 0, 0.5], atol=1e-6)
    assert buffer.maps.depth[60, 80] == pytest.approx(0.5)
    assert buffer.maps.roughness[60, 80] == pytest.approx(0.3)


def test_nothing_outside_the_box_and_box_inside_the_picture():
    buffer = render_gbuffer(assemble([quad(0.3, -2.0)], "small"), CAMERA)
    top, bottom, left, right = buffer.box
    outside = np.ones(buffer.mask.shape, bool)
    outside[top:bottom, left:right] = False
    assert outside.any()
    assert buffer.mask[outside].max() == 0.0
    beside = render_gbuffer(assemble([quad(0.3, -2.0, x=50.0)], "beside"), CAMERA)
    assert beside.mask.max() == 0.0


@pytest.mark.parametrize("width", [0.04, 0.2, 0.7])
def test_rods_thinner_than_a_pixel_are_not_lost(width):
    """A slanted rod, narrower than a pixel, covers the area it has."""
    pixel = 1.0 / CAMERA.focal
    half = 0.5 * width * pixel
    points = np.float32([[-0.3, -0.2, -1], [0.3, 0.25, -1], [0.3, 0.25, -1], [-0.3, -0.2, -1]])
    normal = np.array([-0.45, 0.6]) / 0.75
    points[:2, :2] -= half * normal
    points[2:, :2] += half * normal
    rod = assemble([Piece(points.astype(np.float32), QUAD_FACES, PLAIN)], "rod")
    area = 0.75 * width * pixel * CAMERA.focal**2
    covered = float(render_gbuffer(rod, CAMERA).mask.sum())
    assert covered == pytest.approx(area, rel=0.4 if width < 0.1 else 0.05)


def test_rod_behind_a_wall_does_not_show():
    wall, rod = quad(0.4, -1.0), quad((0.001, 0.3, 1.0), -1.5)
    alone = render_gbuffer(assemble([wall], "wall"), CAMERA)
    both = render_gbuffer(assemble([wall, rod], "both"), CAMERA)
    np.testing.assert_array_equal(alone.mask, both.mask)
    np.testing.assert_allclose(alone.maps.depth, both.maps.depth, atol=1e-6)


def test_whichever_way_a_face_is_wound_its_normal_faces_the_camera():
    away = replace(quad(1.0, -2.0), faces=QUAD_FACES[:, ::-1].copy())
    normals = np.tile(np.float32([0.0, 0.0, -1.0]), (4, 1))
    for piece in (away, replace(quad(1.0, -2.0), normals=normals)):
        buffer = render_gbuffer(assemble([piece], "back"), CAMERA)
        np.testing.assert_allclose(
            buffer.maps.normal[solid(buffer)], [[0, 0, 1]] * solid(buffer).sum()
        )


def test_smooth_normals_that_lean_over_the_rim_are_turned_back():
    vertices, faces, normals = sphere_arrays(0.8, rings=8)
    sphere = assemble([Piece(moved(vertices, z=-3.0), faces, PLAIN, normals)], "coarse")
    buffer = render_gbuffer(sphere, CAMERA)
    seen = buffer.mask > 0.0
    rays = CAMERA.rays() / np.linalg.norm(CAMERA.rays(), axis=-1, keepdims=True)
    away = np.einsum("hwc,hwc->hw", buffer.maps.normal, rays)[seen]
    assert away.max() < 0.02


def test_half_clear_glass_shows_what_is_behind_it():
    glass = Material(base_colour=(1.0, 0.0, 0.0, 0.5), alpha="blend")
    wall = Material(base_colour=(0.0, 0.0, 1.0, 1.0))
    scene = assemble([quad(0.4, -1.0, glass), quad(0.6, -1.5, wall)], "window")
    buffer = render_gbuffer(scene, CAMERA)
    np.testing.assert_allclose(buffer.maps.albedo[60, 80], [0.5, 0.0, 0.5], atol=1e-6)
    assert buffer.maps.depth[60, 80] == pytest.approx(1.25, rel=1e-3)
    assert buffer.mask[60, 80] == 1.0
    alone = render_gbuffer(assemble([quad(0.4, -1.0, glass)], "pane"), CAMERA)
    assert alone.mask[60, 80] == pytest.approx(0.5)
    np.testing.assert_allclose(alone.maps.albedo[60, 80], [0.5, 0.0, 0.0], atol=1e-6)


def test_many_panes_end():
    glass = Material(base_colour=(1.0, 1.0, 1.0, 0.1), alpha="blend")
    panes = assemble([quad(1.0, -1.0 - 0.1 * i, glass) for i in range(12)], "panes")
    mask = render_gbuffer(panes, CAMERA).mask[60, 80]
    assert mask == pytest.approx(1.0 - 0.9**8, abs=1e-4)


def test_leaf_cut_out_by_its_texture():
    picture = np.full((64, 64, 4), 255, np.uint8)
    picture[:, :32, 3] = 0
    leaf = Material(
        base_colour=(1, 1, 1, 1), base_texture=make_texture(picture, colour=True), alpha="mask"
    )
    buffer = render_gbuffer(assemble([quad(0.4, -1.0, leaf)], "leaf"), CAMERA)
    assert buffer.mask[60, 70] == 0.0
    assert buffer.mask[60, 90] == 1.0
    whole = render_gbuffer(assemble([quad(0.4, -1.0)], "whole"), CAMERA)
    assert buffer.mask.sum() == pytest.approx(0.5 * whole.mask.sum(), rel=0.02)


def test_picture_on_a_quad_is_upright_and_sharp(rng):
    picture = rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)
    painted = Material(base_colour=(1, 1, 1, 1), base_texture=make_texture(picture, colour=False))
    buffer = render_gbuffer(assemble([quad(0.3, -1.0, painted)], "painting"), CAMERA)
    top, bottom, left, right = buffer.box
    rows = np.linspace(top + 1, bottom - 1, 17)[1::2].astype(int)
    columns = np.linspace(left + 1, right - 1, 17)[1::2].astype(int)
    found = buffer.maps.albedo[np.ix_(rows, columns)] * 255.0
    assert np.abs(found - picture).mean() < 12.0


def test_fine_pattern_far_away_is_its_mean():
    """One ray a pixel would show noise; the texture's coarser levels average it."""
    picture = np.zeros((512, 512, 3), np.uint8)
    picture[::2, ::2] = picture[1::2, 1::2] = 255
    painted = Material(base_colour=(1, 1, 1, 1), base_texture=make_texture(picture, colour=False))
    buffer = render_gbuffer(assemble([quad(0.3, -1.0, painted)], "fine"), CAMERA)
    inner = buffer.maps.albedo[solid(buffer)]
    np.testing.assert_allclose(inner, 0.5, atol=0.02)


def test_two_colours_side_by_side_are_antialiased():
    """Faces of one plane with different texture coordinates have a colour edge between them."""
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[:, 2:] = 255
    texture = make_texture(picture, colour=False)
    painted = Material(base_colour=(1, 1, 1, 1), base_texture=texture)
    pixel = 1.0 / CAMERA.focal
    black = quad(0.5, -1.0, painted, x=-0.5 + 0.25 * pixel, uv=np.full((4, 2), 0.25))
    white = quad(0.5, -1.0, painted, x=0.5 + 0.25 * pixel, uv=np.full((4, 2), 0.75))
    buffer = render_gbuffer(assemble([black, white], "two"), CAMERA)
    assert buffer.maps.albedo[60, 79, 0] == pytest.approx(0.0, abs=1e-3)
    assert buffer.maps.albedo[60, 80, 0] == pytest.approx(0.75, abs=1e-3)
    assert buffer.maps.albedo[60, 81, 0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("turn", [0.0, np.pi / 2, 1.0])
def test_normal_map_leans_the_way_it_is_painted(mirrored, turn):
    """Red is the picture's right, green its up, whichever way the picture lies on the surface."""
    bump = np.array([0.6, 0.0, 0.8])
    pixels = np.broadcast_to(np.round((0.5 + 0.5 * bump) * 65535).astype(np.uint16), (4, 4, 3))
    material = Material(normal_texture=make_texture(pixels, colour=False))
    cos, sin = np.cos(turn), np.sin(turn)
    uv = QUAD_UV - 0.5
    uv = uv @ np.float32([[cos, sin], [-sin, cos]])
    if mirrored:
        uv[:, 0] *= -1.0
    buffer = render_gbuffer(assemble([quad(0.4, -1.0, material, uv=uv + 0.5)], "bump"), CAMERA)
    # The direction on the surface in which u grows: right at turn 0.
    basis = np.linalg.lstsq(
        np.column_stack([uv, np.ones(4)]), QUAD[:, :2].astype(np.float64), rcond=None
    )[0]
    right = basis[0] / np.linalg.norm(basis[0])
    wanted = np.array([*(0.6 * right), 0.8])
    np.testing.assert_allclose(buffer.maps.normal[60, 80], wanted, atol=2e-3)


def test_normal_map_up_is_up():
    bump = np.array([0.0, 0.6, 0.8])
    pixels = np.broadcast_to(np.round((0.5 + 0.5 * bump) * 65535).astype(np.uint16), (4, 4, 3))
    material = Material(normal_texture=make_texture(pixels, colour=False))
    buffer = render_gbuffer(assemble([quad(0.4, -1.0, material)], "bump"), CAMERA)
    np.testing.assert_allclose(buffer.maps.normal[60, 80], bump, atol=2e-3)
    flat = replace(material, normal_scale=0.0)
    buffer = render_gbuffer(assemble([quad(0.4, -1.0, flat)], "flat"), CAMERA)
    np.testing.assert_allclose(buffer.maps.normal[60, 80], [0, 0, 1], atol=2e-3)


def test_vertex_colours_blend_over_a_face():
    colours = np.float32([[0, 0, 0, 1], [1, 1, 1, 1], [1, 1, 1, 1], [0, 0, 0, 1]])
    white = Material(base_colour=(1, 1, 1, 1))
    piece = replace(quad(0.4, -1.0, white), colours=colours)
    buffer = render_gbuffer(assemble([piece, quad(0.1, -5.0)], "ramp"), CAMERA)
    row = buffer.maps.albedo[60, solid(buffer)[60], 0]
    assert (np.diff(row) > 0).all()
    assert row[len(row) // 2] == pytest.approx(0.5, abs=0.01)


def test_same_product_same_bytes():
    vertices, faces, normals = sphere_arrays(0.8, rings=20)
    sphere = assemble([Piece(moved(vertices, z=-3.0), faces, PLAIN, normals)], "sphere")
    one, two = (render_gbuffer(sphere, CAMERA) for _ in range(2))
    for name in ("albedo", "normal", "depth", "roughness", "metallic"):
        np.testing.assert_array_equal(getattr(one.maps, name), getattr(two.maps, name))
