"""A caster made of mask and depth, where there is no mesh."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import shadow_scenes as known

from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.scenes.scene import Intrinsics
from spotlight_runtime.shadows.receiver import receiver_of
from spotlight_runtime.shadows.relief import relief_mesh


def relief_of(scene):
    return relief_mesh(scene, receiver_of(scene, scene.ground), scene.ground)


def open_edges(mesh):
    """Edges that do not have two triangles, one in each direction."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    forward = {tuple(e) for e in edges}
    return [e for e in forward if (e[1], e[0]) not in forward]


@given(st.integers(1, 14), st.integers(1, 14), st.integers(0, 2**32 - 1))
def test_any_mask_becomes_a_closed_mesh(height, width, seed):
    rng = np.random.default_rng(seed)
    mask = (rng.random((height, width)) < 0.6).astype(np.float32)
    mask[0, 0] = 1.0
    grey = np.full((height, width, 3), 0.5, np.float32)
    depth = rng.uniform(2, 4, (height, width)).astype(np.float32)
    scene = replace(
        known.ball_scene(8),
        background=grey,
        background_maps=Intrinsics(grey, depth=np.full((height, width), 5.0, np.float32)),
        object_maps=Intrinsics(mask[..., None] * grey, depth=mask * depth),
        object_mask=mask,
        object_mesh=None,
    )
    mesh = relief_of(scene)
    assert not open_edges(mesh)
    assert (mesh.vertices[:, 2] < 0).all()


def test_a_ball_s_relief_is_a_ball():
    scene = known.ball_scene(160)
    vertices = relief_of(scene).vertices
    centre = known.ball_centre(scene.ground)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    np.testing.assert_allclose((high - low)[:2], 2 * known.RADIUS, rtol=0.15)
    # The back is the front's depth plus a round cross-section.
    assert 0.7 < (high - low)[2] / (2 * known.RADIUS) < 1.6
    assert np.linalg.norm((low + high) / 2 - centre) < 0.5 * known.RADIUS


@pytest.mark.parametrize("azimuth", [0, 45, 90, 135, 180, 225, 315])
def test_its_shadow_is_close_to_the_mesh_s(azimuth):
    pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")
    from spotlight_runtime.shadows.shadow import ShadowCaster

    scene = known.ball_scene(128)
    light = Light(azimuth, 40, radius=0.3)
    whole = ShadowCaster(scene).cast(light).shadow > 0.5
    guessed = ShadowCaster(replace(scene, object_mesh=None)).cast(light).shadow > 0.5
    assert (whole & guessed).sum() / (whole | guessed).sum() > 0.7


def test_the_footprint_aligns_it_to_the_background():
    """Object depth in another unit, as estimators give it."""
    scene = known.ball_scene(96)
    depth, mask = scene.object_maps.depth, scene.object_mask
    rows = np.arange(96)[:, None]
    foot = (mask > 0) & (rows > np.flatnonzero(mask.any(axis=1))[-1] - 6)
    ground = scene.background_maps.depth
    other = replace(
        scene,
        object_maps=replace(scene.object_maps, depth=mask * (depth - 1.0) / 2),
        footprint_depth=np.where(foot, (ground - 1.0) / 2, 0.0).astype(np.float32),
        object_mesh=None,
    )
    got, wanted = relief_of(other).vertices, relief_of(scene).vertices
    for bound in (np.min, np.max):
        np.testing.assert_allclose(bound(got, 0), bound(wanted, 0), atol=0.15)


def test_depth_mixed_along_the_outline_is_not_trusted():
    scene = known.ball_scene(96)
    mask = scene.object_mask.copy()
    edge = (mask > 0) & (np.roll(mask, 1, 1) == 0)
    mask[edge] = 0.6
    depth = np.where(edge, 50.0, scene.object_maps.depth) * mask
    spoilt = replace(
        scene,
        object_mask=mask,
        object_maps=replace(scene.object_maps, depth=depth.astype(np.float32)),
        object_mesh=None,
    )
    assert np.ptp(relief_of(spoilt).vertices[:, 2]) < 2.0
    thin = replace(spoilt, object_mask=np.where(mask > 0, 0.6, 0).astype(np.float32))
    assert len(relief_of(thin).faces) > 0  # nothing is fully covered: then all is taken


def test_large_objects_are_thinned_out():
    scene = known.ball_scene(700, object_mesh=None)
    scene = replace(scene, object_mask=np.ones_like(scene.object_mask))
    full = replace(scene.object_maps, depth=np.full(scene.size, 3.0, np.float32))
    assert len(relief_of(replace(scene, object_maps=full)).faces) < 300_000


def test_an_object_without_depth_stands_up_as_a_card():
    scene = known.ball_scene(96)
    flat = replace(scene, object_maps=Intrinsics(scene.object_maps.albedo), object_mesh=None)
    vertices = relief_of(flat).vertices @ scene.ground.world_axes().T
    height = vertices[: len(vertices) // 2, 2] - scene.ground.offset
    assert abs(height.min()) < 0.02
    front = vertices[: len(vertices) // 2]  # the back, seen along the rays, goes into the floor
    assert np.ptp(front[:, 1]) < 0.02
    assert np.ptp(front[:, 2]) > known.RADIUS
    no_floor = replace(flat, ground=None)
    assert len(relief_of(no_floor).faces) == len(relief_of(flat).faces)


def test_an_object_that_hangs_in_the_sky_has_no_card():
    scene = known.ball_scene(96)
    sky = np.full(scene.size, 20.0, np.float32)
    flat = replace(
        scene,
        background_maps=Intrinsics(scene.background_maps.albedo, depth=sky),
        object_maps=Intrinsics(scene.object_maps.albedo),
    )
    with pytest.raises(InvalidInputError, match="floor under the lowest point"):
        relief_of(flat)


def test_an_empty_mask_is_said():
    scene = known.ball_scene(32)
    with pytest.raises(InvalidInputError, match="mask that covers a part"):
        relief_of(replace(scene, object_mask=np.zeros_like(scene.object_mask)))


def test_depth_that_lands_behind_the_camera_is_said():
    scene = known.ball_scene(64)
    maps = replace(scene.object_maps, depth=scene.object_mask * np.float32(3))
    maps.depth[scene.object_mask > 0] += np.linspace(0, 9, int(scene.object_mask.sum()))
    tiny = np.full(scene.size, 0.01, np.float32)
    background = Intrinsics(scene.background_maps.albedo, depth=tiny)
    foot = np.where(scene.object_mask > 0, 8.0, 0.0).astype(np.float32)
    with pytest.raises(InvalidInputError, match="in front of the camera"):
        relief_of(
            replace(scene, object_maps=maps, background_maps=background, footprint_depth=foot)
        )
