"""Cast shadows in scenes: what receives, what is in the way, what is said where none is seen."""

import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")

from hypothesis import given, settings
from hypothesis import strategies as st
from support import shadow_scenes as known

from spotlight_runtime.errors import GroundError, InvalidInputError, LightError, ShadowWarning
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.scenes.scene import Intrinsics
from spotlight_runtime.shadows.placement import box_of, place_light
from spotlight_runtime.shadows.reach import reachable
from spotlight_runtime.shadows.receiver import receiver_of
from spotlight_runtime.shadows.shadow import ShadowCaster, cast_shadow, floor_of

LIGHT = Light(135, 45, radius=0.5)
lights = st.builds(
    Light,
    st.floats(0, 360),
    st.floats(15, 80),
    st.sampled_from([0.0, 0.3, 1.0, 2.5]),
    st.sampled_from([None, 5.0, 10.0]),
)


def cast_quietly(scene, light, **options):
    return ShadowCaster(scene).cast(light, **options).shadow


def with_depth(scene, depth, normal=None):
    return replace(
        scene, background_maps=Intrinsics(scene.background_maps.albedo, normal=normal, depth=depth)
    )


@settings(max_examples=15)
@given(lights)
def test_a_shadow_is_a_share_and_never_lies_on_the_object(light):
    scene = known.ball_scene(48)
    shadow = cast_quietly(scene, light)
    assert shadow.dtype == np.float32
    assert shadow.shape == scene.size
    assert shadow.min() >= 0.0
    assert shadow.max() <= 1.0
    assert not shadow[scene.object_mask == 1.0].any()


def test_the_object_s_edge_takes_its_share_of_the_pixel():
    scene = known.ball_scene(64)
    half = replace(scene, object_mask=scene.object_mask * np.float32(0.5))
    caster = ShadowCaster(half)
    assert caster.cast(LIGHT).shadow[scene.object_mask > 0].max() <= 0.5


@settings(max_examples=10)
@given(lights)
def test_mirrored_light_mirrored_shadow(light):
    """The ball stands straight ahead, so left and right are alike."""
    scene = known.ball_scene(64)
    shadow = cast_quietly(scene, light, samples=256)
    mirrored = cast_quietly(scene, replace(light, azimuth=180 - light.azimuth), samples=256)
    # The samples are not symmetric, only what they average to.
    assert np.abs(shadow - mirrored[:, ::-1]).max() < 0.12
    assert abs(shadow.sum() - mirrored.sum()) < 0.01 * shadow.sum() + 1.0


@settings(max_examples=8)
@given(lights, st.sampled_from([0.01, 0.5, 3.0, 40.0]))
def test_units_do_not_matter(light, scale):
    """Lengths are in object sizes: a scene in centimetres has the same shadow as in metres."""
    scene = known.ball_scene(48)
    maps = scene.background_maps
    near = np.where(maps.depth > 15.0, 0.0, maps.depth).astype(np.float32)  # no sky to scale
    scene = replace(scene, background_maps=replace(maps, depth=near))
    mesh, ground = scene.object_mesh, scene.ground
    scaled = replace(
        scene,
        background_maps=replace(maps, depth=near * np.float32(scale)),
        object_mesh=ObjectMesh(mesh.vertices * np.float32(scale), mesh.faces),
        ground=replace(ground, offset=ground.offset * scale),
    )
    if near.max() * scale > 20.0:  # what lies at the depth map's cut is sky
        return
    difference = np.abs(cast_quietly(scene, light) - cast_quietly(scaled, light))
    assert (difference > 0.05).mean() < 0.002


@pytest.mark.parametrize("light", [LIGHT, Light(20, 25, 1.5), Light(250, 40, 0.0, None)])
def test_only_what_is_out_of_reach_is_left_out(light):
    """No shadow is lost by testing a lattice of pixels against the object's box."""
    scene = known.ball_scene(150)
    caster = ShadowCaster(scene)
    receiver = receiver_of(scene, scene.ground)
    box = box_of(scene.object_mesh, scene.ground)
    placed = place_light(light, box, scene.object_mesh, scene.ground)
    pixels = reachable(receiver, placed, box, scene.object_mask)
    assert 0 < len(pixels) < 0.7 * scene.object_mask.size
    points, centre = known.floor_points(scene), known.ball_centre(scene.ground)
    for spot in ([0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]):  # the light's middle and its rim
        axes = np.linalg.qr(np.stack([placed.centre, [1, 2, 3], [3, -1, 2]]).T)[0].T
        towards = placed.centre + placed.radius * (spot[0] * axes[1] + spot[1] * axes[2])
        if not placed.directional:
            towards = towards - points
        hidden = known.ball_hides(points, towards, centre) & (scene.object_mask < 1)
        hidden &= receiver.inverse_depth > 0
        assert hidden.any()
        assert set(np.flatnonzero(hidden)) <= set(pixels)
    assert caster.cast(light).shadow.max() > 0.9


def test_a_floor_without_depth_receives_the_same():
    scene = known.ball_scene(96)
    flat = replace(scene, background_maps=Intrinsics(scene.background_maps.albedo))
    np.testing.assert_allclose(
        cast_shadow(flat, LIGHT)[30:], cast_shadow(scene, LIGHT)[30:], atol=0.02
    )


@pytest.mark.parametrize("light", [LIGHT, Light(30, 30, 1.5)])
def test_normals_are_taken_from_the_depth_where_there_are_none(light):
    scene = known.ball_scene(96)
    bare = with_depth(scene, scene.background_maps.depth)
    difference = np.abs(cast_shadow(bare, light) - cast_shadow(scene, light))
    assert difference.max() < 0.05


def test_a_floor_not_given_is_found():
    scene = known.ball_scene(96)
    found = floor_of(replace(scene, ground=None))
    np.testing.assert_allclose(found.normal, scene.ground.normal, atol=2e-3)
    difference = cast_shadow(replace(scene, ground=None), LIGHT) - cast_shadow(scene, LIGHT)
    assert np.abs(difference).max() < 0.05


def test_an_unknown_depth_or_sky_receives_nothing():
    scene = known.ball_scene(96)
    shadow = cast_shadow(scene, LIGHT)
    hole = shadow > 0.9
    depth = np.where(hole, 0.0, scene.background_maps.depth).astype(np.float32)
    assert not cast_quietly(with_depth(scene, depth), LIGHT)[hole].any()
    sky = np.where(hole, 20.0, np.minimum(scene.background_maps.depth, 20)).astype(np.float32)
    assert not cast_quietly(with_depth(scene, sky), LIGHT)[hole].any()


def test_edges_in_depth_are_cut_not_stretched():
    """A step in the floor: each side takes the shadow its own height gives it."""
    scene = known.ball_scene(128)
    axes, ground = scene.ground.world_axes(), scene.ground
    low = known.floor_depth(scene.camera, replace(ground, offset=ground.offset - 0.3))
    depth = scene.background_maps.depth.copy()
    beyond = (scene.camera.unproject(depth) @ axes[0].astype(np.float32)) > 0.7
    stepped = np.where(beyond, low, depth)
    scene = replace(scene, ground=None)
    light = Light(160, 35, radius=0.0, distance=None)
    normal = scene.background_maps.normal
    whole = cast_quietly(replace(with_depth(scene, depth, normal), ground=ground), light)
    deep = cast_quietly(replace(with_depth(scene, low, normal), ground=ground), light)
    both = cast_quietly(replace(with_depth(scene, stepped, normal), ground=ground), light)
    assert (whole[~beyond] > 0.5).sum() > 100
    assert np.abs(both - whole)[~beyond].mean() < 1e-3
    # At the foot of the step the floor lies in the shadow of the step itself.
    clear = (scene.camera.unproject(low) @ axes[0].astype(np.float32)) > 0.75 + 0.3 / np.tan(0.6)
    assert (deep[clear & beyond] > 0.5).sum() > 50
    assert np.abs(both - deep)[clear & beyond].mean() < 0.01


def table_scene(side=128):
    """The ball on a table half a metre high whose top ends right of it."""
    scene = known.ball_scene(side)
    ground, camera = scene.ground, scene.camera
    top = replace(ground, offset=ground.offset + 0.5)
    depth, above = known.floor_depth(camera, ground), known.floor_depth(camera, top)
    places = camera.unproject(above) @ ground.world_axes().T.astype(np.float32)
    on_top = (np.abs(places[..., 0]) < 0.6) & (np.abs(places[..., 1] - known.AWAY) < 0.6)
    centre = np.array([0.0, known.AWAY, top.offset + known.RADIUS]) @ ground.world_axes()
    scene = replace(scene, object_mesh=known.sphere_mesh(centre, known.RADIUS), ground=top)
    mapped = np.where(on_top, above, depth)
    return with_depth(scene, mapped, scene.background_maps.normal), on_top


def test_what_lies_in_the_background_s_own_shadow_gets_none():
    """Under a table lit from above its top is in the way: the floor below is dark already."""
    scene, on_top = table_scene()
    light = Light(180, 60, radius=0.0, distance=None)
    placed = place_light(light, box_of(scene.object_mesh, scene.ground), scene.object_mesh, None)
    points = known.floor_points(scene)
    centre = scene.object_mesh.vertices.mean(axis=0)
    behind_the_ball = known.ball_hides(points, placed.centre, centre)
    up, axes = np.asarray(scene.ground.normal), scene.ground.world_axes()
    rise = (scene.ground.offset - points @ up) / (placed.centre @ up)
    through = (points + rise[..., None] * placed.centre) @ axes.T
    under = ~on_top & (rise > 0.1)
    under &= (np.abs(through[..., 0]) < 0.5) & (np.abs(through[..., 1] - known.AWAY) < 0.5)
    beside = ~on_top & (np.abs(through[..., 0]) > 0.7)
    shadow = cast_shadow(replace(scene, object_mask=np.zeros_like(scene.object_mask)), light)
    assert (behind_the_ball & under).sum() > 50
    assert shadow[behind_the_ball & under].max() < 0.01
    assert shadow[behind_the_ball & beside].min(initial=1.0) > 0.5
    assert shadow[behind_the_ball & on_top].mean() > 0.9


def test_a_wall_between_light_and_object_is_taken_out_of_the_way():
    """Ten object sizes are beyond the wall of most rooms."""
    scene = known.ball_scene(96)
    axes = scene.ground.world_axes()
    ahead = scene.camera.rays() @ axes[1].astype(np.float32)
    wall = np.where(ahead > 0.01, 3.5 / np.maximum(ahead, 0.01), 20.0)
    depth = np.minimum(scene.background_maps.depth, wall).astype(np.float32)
    normal = np.where((wall < scene.background_maps.depth)[..., None], -axes[1], axes[2])
    walled = with_depth(scene, depth, normal.astype(np.float32))
    for azimuth in (60, 90, 120):
        light = Light(azimuth, 30, radius=0.5)
        on_floor = wall >= scene.background_maps.depth
        difference = cast_shadow(walled, light) - cast_shadow(scene, light)
        assert np.abs(difference)[on_floor].max() < 0.1


def test_a_surface_turned_away_from_the_light_has_no_shadow_to_lose():
    scene = known.ball_scene(64)
    away = np.broadcast_to(-np.float32(scene.ground.normal), (64, 64, 3)).copy()
    turned = with_depth(scene, scene.background_maps.depth, away)
    assert not cast_quietly(turned, LIGHT).any()


@pytest.mark.parametrize("radius", [0.0, 1.0])
def test_the_least_pictures(radius):
    for width, height in ((1, 1), (2, 1), (1, 3), (3, 2)):
        scene = known.ball_scene(height, width)
        assert cast_quietly(scene, replace(LIGHT, radius=radius)).shape == (height, width)


# What is said


def test_a_shadow_that_is_seen_goes_without_saying():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cast_shadow(known.ball_scene(64), LIGHT)


def moved(away, right=0.0, **changes):
    """The ball elsewhere on its floor, perhaps out of the picture."""
    scene = known.ball_scene(96)
    centre = np.array([right, away, scene.ground.offset + known.RADIUS])
    mesh = known.sphere_mesh(centre @ scene.ground.world_axes(), known.RADIUS)
    mask = np.zeros_like(scene.object_mask)
    return replace(scene, object_mesh=mesh, object_mask=mask, **changes)


@pytest.mark.parametrize(
    ("scene", "light", "said"),
    [
        (moved(0.2), Light(90, 20, 0.2), "behind the camera"),
        (moved(2.6, right=-2.0), Light(0, 30, 0.2), "to the left of the picture"),
        (moved(2.6, right=2.0), Light(180, 30, 0.2), "to the right of the picture"),
        (moved(0.9), Light(90, 50, 0.2), "below the picture"),
        (known.ball_scene(96), Light(270, 24, 0.2), "hides its own shadow"),
    ],
)
def test_a_shadow_that_is_not_seen_says_where_it_falls(scene, light, said):
    cast = ShadowCaster(scene).cast(light)
    assert said in cast.notice
    with pytest.warns(ShadowWarning, match=said):
        np.testing.assert_array_equal(cast_shadow(scene, light), cast.shadow)


def test_a_light_no_higher_than_the_object_is_said():
    scene = known.ball_scene(96)
    axes = scene.ground.world_axes()
    lamp = Light(position=(3.0, 0.0, 0.02), radius=0.0)
    hung = ObjectMesh(scene.object_mesh.vertices + np.float32(axes[2]), scene.object_mesh.faces)
    lifted = replace(scene, object_mesh=hung)
    low = replace(lamp, position=(3.0, 0.0, -0.9))
    assert "no shadow reaches the floor" in ShadowCaster(lifted).cast(low).notice


def test_without_a_floor_a_notice_is_general():
    scene = known.ball_scene(64)
    depth = np.full(scene.size, 6.0, np.float32)
    facing = np.zeros((64, 64, 3), np.float32)
    facing[..., 2] = 1.0
    wall = replace(with_depth(scene, depth, facing), ground=None)
    light = Light(0, 80, radius=0.0, distance=3.0, frame="camera")
    assert "turn the light" in ShadowCaster(wall).cast(light).notice
    with pytest.raises(GroundError, match="whose floor is known"):
        cast_shadow(wall, replace(light, frame="world"))


def test_a_shadow_on_what_receives_nothing_is_said():
    scene = known.ball_scene(64)
    depth = np.where(cast_shadow(scene, LIGHT) > 0, 0.0, scene.background_maps.depth)
    notice = ShadowCaster(with_depth(scene, depth.astype(np.float32))).cast(LIGHT).notice
    assert "check the depth map" in notice


def test_impossible_shadows_are_errors():
    scene = known.ball_scene(64)
    with pytest.raises(LightError, match="above the floor"):
        cast_shadow(scene, Light(0, -20))
    with pytest.raises(LightError, match="outside the object"):
        cast_shadow(scene, Light(0, 20, radius=1.0, distance=1.0))
    with pytest.raises(InvalidInputError, match="samples: expected at least 1"):
        cast_shadow(scene, LIGHT, samples=0)
    nothing = Intrinsics(scene.background_maps.albedo)
    with pytest.raises(GroundError, match="has neither"):
        cast_shadow(replace(scene, background_maps=nothing, ground=None), LIGHT)


def test_lights_in_both_frames_agree_under_a_level_camera():
    scene = known.ball_scene(96)
    level = known.floor(0.0)
    centre = known.ball_centre(level, away=4.5)
    depth = known.floor_depth(scene.camera, level)
    scene = replace(
        with_depth(scene, depth),
        object_mesh=known.sphere_mesh(centre, known.RADIUS),
        ground=level,
        object_mask=np.zeros_like(scene.object_mask),
    )
    world, camera = cast_shadow(scene, LIGHT), cast_shadow(scene, replace(LIGHT, frame="camera"))
    assert np.abs(world - camera).max() < 0.02
    direction = known.light_direction(level, 135, 45) * 10 * 2 * known.RADIUS
    position = tuple(float(v) for v in centre + direction)
    placed = Light(position=position, radius=LIGHT.radius, frame="camera")
    assert np.abs(world - cast_shadow(scene, placed)).max() < 0.05


def test_a_missing_ray_caster_is_one_line_with_the_command():
    script = """
import importlib.util, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "embreex" else find(name, *rest)
from spotlight_runtime.errors import MissingExtraError
from spotlight_runtime.shadows.shadow import ShadowCaster
try:
    ShadowCaster(None)
except MissingExtraError as error:
    print(error, "embreex" in sys.modules, "trimesh" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert "pip install 'spotlight-relight[scene]'" in done.stdout
    assert done.stdout.strip().endswith("False False")
