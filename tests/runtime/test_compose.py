"""Photograph + object → scene: the parts together, and what cannot be put together."""

from dataclasses import replace

import numpy as np
import pytest
from support.models import box_arrays, sphere_arrays
from support.rooms import room

from runtime.scene_comparison import arrays_of
from spotlight_runtime import Intrinsics, Scene
from spotlight_runtime.composing.cutout import Cutout
from spotlight_runtime.composing.materials import Material
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.composing.posing import Placement
from spotlight_runtime.composing.product import Piece, assemble
from spotlight_runtime.diffusion.conditioning import align_depth, conditioning_array
from spotlight_runtime.errors import GroundError, PlacementError
from spotlight_spec import BACKBONES

pytest.importorskip("embreex", reason="ray casting needs the extra scene")

from spotlight_runtime.composing.compose import compose, draft

RED = Material(base_colour=(0.7, 0.1, 0.1, 1.0))
BACKDROP = room(240, 180)


def ball(radius=0.3):
    vertices, faces, normals = sphere_arrays(radius, rings=40)
    lifted = vertices + np.float32([0, radius, 0])
    return assemble([Piece(lifted, faces, RED, normals)], "ball")


def cube(side=0.6):
    return assemble([Piece(*box_arrays((side, side, side)), RED)], "cube")


@pytest.fixture(scope="module")
def scene():
    return compose(BACKDROP, cube(), Placement((0.5, 0.7), yaw=25.0))


def test_scene_has_everything_a_relight_needs(scene):
    assert scene.size == (180, 240)
    for name in ("albedo", "normal", "depth"):
        assert scene.has_map(name)
    assert scene.field_of_view == 60.0
    assert scene.ground == BACKDROP.ground
    assert scene.name == "room-cube"
    assert scene.footprint_depth.max() > 0.0
    assert scene.object_mesh.faces.shape == (12, 3)
    shadow = np.zeros(scene.size, np.float32)
    array = conditioning_array(BACKBONES["zerocomp-openrooms"], scene, shadow)
    assert np.isfinite(array).all()


def test_background_is_the_photograph_bit_for_bit(scene):
    np.testing.assert_array_equal(scene.background, BACKDROP.photograph.radiance)


def test_object_stands_on_the_floor_where_it_was_put(scene):
    m, c = align_depth(
        scene.object_maps.depth,
        scene.object_mask,
        scene.background_maps.depth,
        scene.footprint_depth,
    )
    assert m == pytest.approx(1.0, abs=0.01)
    assert c == pytest.approx(0.0, abs=0.05)
    rows, columns = np.nonzero(scene.footprint_depth > 0)
    assert columns.mean() / 240 == pytest.approx(0.5, abs=0.02)
    assert rows.mean() / 180 == pytest.approx(0.7, abs=0.02)
    assert np.flatnonzero((scene.object_mask > 0.5).any(axis=1)).max() / 180 > 0.7


def test_mesh_and_maps_agree(scene):
    from spotlight_runtime.composing.gbuffer import image_box

    top, bottom, left, right = image_box(scene.object_mesh.vertices, scene.camera)
    covered = scene.object_mask > 0.0
    assert covered[top:bottom, left:right].sum() == covered.sum()
    rows, columns = np.nonzero(covered)
    assert (rows.min() - top, bottom - rows.max()) <= (3, 4)
    assert (columns.min() - left, right - columns.max()) <= (3, 4)


def test_scene_survives_its_bundle(scene, tmp_path):
    scene.save(tmp_path / "scene")
    loaded = Scene.load(tmp_path / "scene")
    before, after = arrays_of(scene), arrays_of(loaded)
    assert before.keys() == after.keys()
    for name, value in before.items():
        np.testing.assert_allclose(after[name], value, atol=1e-4, err_msg=name)
    np.testing.assert_array_equal(loaded.object_mesh.vertices, scene.object_mesh.vertices)


def test_pose_does_not_change_what_is_not_the_object(scene):
    other = compose(BACKDROP, ball(), Placement((0.3, 0.8)))
    for name in ("albedo", "normal", "depth"):
        assert getattr(other.background_maps, name) is getattr(BACKDROP.maps, name)
    assert not (other.object_mask * scene.object_mask).all()


def test_given_roughness_is_kept():
    rough = np.full((180, 240), 0.2, np.float32)
    backdrop = replace(BACKDROP, maps=replace(BACKDROP.maps, roughness=rough))
    composed = compose(backdrop, ball(), Placement((0.3, 0.8)))
    assert composed.background_maps.roughness is rough
    assert composed.background_maps.metallic is None


def test_screen_hides_the_object_unless_told_otherwise():
    screened = room(240, 180, block=(-5.0, 0.0, 1.2))
    whole = compose(screened, cube(), Placement((0.5, 0.7)), occluded=False)
    half = compose(screened, cube(), Placement((0.5, 0.7)))
    assert 0.3 < half.object_mask.sum() / whole.object_mask.sum() < 0.7
    assert half.object_maps.albedo[half.object_mask == 0.0].max() == 0.0
    hidden = room(240, 180, block=(-5.0, 5.0, 1.2))
    with pytest.raises(PlacementError, match=r"hidden by something nearer.*--no-occlusion"):
        compose(hidden, cube(), Placement((0.5, 0.7)))


@pytest.mark.parametrize(
    ("placement", "error", "said"),
    [
        (Placement((0.5, 0.05)), GroundError, "horizon"),
        (Placement((0.5, 0.7), size=0.001), PlacementError, "too small"),
        (Placement((0.5, 0.9), size=40.0), PlacementError, "behind the camera"),
    ],
)
def test_what_cannot_be_placed(placement, error, said):
    with pytest.raises(error, match=said):
        compose(BACKDROP, cube(), placement)


def test_object_that_fills_the_picture():
    wall = assemble([Piece(*box_arrays((30.0, 4.0, 0.01)), RED)], "wall")
    with pytest.raises(PlacementError, match=r"covers the whole picture.*smaller"):
        compose(BACKDROP, wall, Placement((0.5, 0.999)))


def test_cutout_stands_in_the_scene_like_a_product():
    rows, columns = np.mgrid[:60, :40]
    mask = ((rows - 30) ** 2 / 900 + (columns - 20) ** 2 / 400 < 0.9).astype(np.float32)
    maps = Intrinsics(
        albedo=np.full((60, 40, 3), 0.5, np.float32),
        normal=np.broadcast_to(np.float32([0, 0, 1]), (60, 40, 3)).copy(),
        depth=np.full((60, 40), 2.0, np.float32),
    )
    figure = Cutout(Photograph(np.full((60, 40, 3), 0.4, np.float32), name="figure"), mask, maps)
    composed = compose(BACKDROP, figure, Placement((0.5, 0.8), height=0.8))
    assert composed.object_mesh is None
    assert composed.name == "room-figure"
    assert composed.footprint_depth.max() > 0.0
    assert 0.005 < composed.object_mask.mean() < 0.2
    assert draft(composed).shape == (180, 240, 3)


def test_draft_shows_the_object_in_the_photograph(scene):
    picture = draft(scene)
    assert picture.shape == (180, 240, 3)
    solid = scene.object_mask == 1.0
    assert (picture[solid][:, 0] > 1.5 * picture[solid][:, 1]).mean() > 0.95
    large = replace(BACKDROP, photograph=room(1600, 400).photograph, maps=room(1600, 400).maps)
    composed = compose(large, ball(), Placement((0.5, 0.8)))
    assert draft(composed).shape == (256, 1024, 3)


def test_same_request_same_scene(scene):
    again = compose(BACKDROP, cube(), Placement((0.5, 0.7), yaw=25.0))
    for name, value in arrays_of(scene).items():
        np.testing.assert_array_equal(arrays_of(again)[name], value, err_msg=name)
