"""Cast shadows against closed forms: a ball on a plane under lights of every kind."""

import numpy as np
import pytest

pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")

import cv2
from support import shadow_scenes as known

from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.shadows.shadow import cast_shadow

SIZE = 2 * known.RADIUS
"""The object size that radius and distance count in."""


def seen(scene, margin=0):
    """Pixels of the floor that show beside the ball."""
    hidden = cv2.dilate(scene.object_mask, np.ones((2 * margin + 1,) * 2, np.uint8)) > 0
    return ~hidden & (scene.background_maps.depth < 19.9)


def away_from_the_outline(hidden):
    """Pixels whose neighbours all agree."""
    grey = hidden.astype(np.uint8)
    return cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) == 0


@pytest.mark.parametrize("azimuth", [0, 60, 135, 200, 315])
@pytest.mark.parametrize("distance", [None, 4.0])
def test_light_without_extent(azimuth, distance):
    scene = known.ball_scene(160)
    light = Light(azimuth, 40, radius=0.0, distance=distance)
    shadow = cast_shadow(scene, light)
    centre = known.ball_centre(scene.ground)
    towards = known.light_direction(scene.ground, azimuth, 40)
    points = known.floor_points(scene)
    if distance is not None:
        towards = centre + towards * distance * SIZE - points
    hidden = known.ball_hides(points, towards, centre)
    sure = seen(scene) & away_from_the_outline(hidden)
    sure[:, [0, -1]] = sure[[0, -1]] = False  # the outline may pass between them and the edge
    assert hidden[sure].sum() > 200
    np.testing.assert_array_equal(shadow[sure], hidden[sure])
    # The outline is antialiased: the area is right to a fraction of its pixels.
    outline = (seen(scene) & ~away_from_the_outline(hidden)).sum()
    assert abs(shadow[seen(scene)].sum() - hidden[seen(scene)].sum()) < 0.05 * outline
    between = (shadow > 0.05) & (shadow < 0.95)
    assert between.sum() > 0.2 * outline


@pytest.mark.parametrize(("azimuth", "elevation"), [(135, 45), (20, 60), (70, 30)])
def test_round_light(azimuth, elevation):
    """The share of the light's disc behind the ball: two caps on the sphere of directions."""
    scene = known.ball_scene(128)
    shadow = cast_shadow(scene, Light(azimuth, elevation, radius=1.0, distance=10.0))
    wanted = round_light_shadow(scene, azimuth, elevation, 1.0, 10.0)
    free = seen(scene, margin=1)
    assert ((wanted > 0.02) & (wanted < 0.98))[free].sum() > 300
    # What the closed form leaves out: the cosine's slope over the light, the pixel's extent.
    assert np.abs(shadow - wanted)[free].mean() < 0.003
    assert np.abs(shadow - wanted)[free].max() < 0.1
    for level in (0.0, 1.0):
        sure = free & (wanted == level) & away_from_the_outline(wanted == level)
        assert sure.sum() > 100
        assert np.abs(shadow - level)[sure].max() < 0.005


@pytest.mark.parametrize(("side", "radius", "distance"), [(128, 0.8, 4.0), (400, 3.0, 10.0)])
@pytest.mark.parametrize(("azimuth", "elevation"), [(135, 45), (70, 30)])
def test_wide_light(side, radius, distance, azimuth, elevation):
    """The same with the cosine at the floor: exact visibility, summed over the cone of the light.

    The large picture has so much penumbra that most of it is interpolated.
    """
    scene = known.ball_scene(side)
    shadow = cast_shadow(scene, Light(azimuth, elevation, radius=radius, distance=distance))
    some = np.s_[1 :: side // 64, 1 :: side // 64]
    points = known.floor_points(scene)[some]
    wanted = wide_light_shadow(points, scene.ground, azimuth, elevation, radius, distance)
    shadow, free = shadow[some], seen(scene, margin=1)[some]
    assert ((wanted > 0.02) & (wanted < 0.98))[free].mean() > 0.04
    assert np.abs(shadow - wanted)[free].mean() < 0.003
    assert abs((shadow - wanted)[free].mean()) < 0.0005  # no bias
    assert np.abs(shadow - wanted)[free].max() < 0.08


def wide_light_shadow(points, ground, azimuth, elevation, radius, distance, rings=20, spokes=40):
    centre = known.ball_centre(ground)
    light = centre + known.light_direction(ground, azimuth, elevation) * distance * SIZE
    axis = light - points
    far = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis /= far
    right = np.cross(axis, ground.normal)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    up = np.cross(right, axis)
    narrowest = np.sqrt(1 - (radius * SIZE / far) ** 2)
    hidden = total = 0.0
    for ring in (np.arange(rings) + 0.5) / rings:
        cosine = 1 - ring * (1 - narrowest)  # uniform in solid angle
        sine = np.sqrt(1 - cosine**2)
        for angle in (np.arange(spokes) + 0.5) * 2 * np.pi / spokes:
            towards = cosine * axis + sine * (np.cos(angle) * right + np.sin(angle) * up)
            light = np.maximum(towards @ ground.normal, 0)
            total = total + light
            hidden = hidden + light * known.ball_hides(points, towards, centre)
    return hidden / np.maximum(total, 1e-9)


def round_light_shadow(scene, azimuth, elevation, radius, distance):
    points, centre = known.floor_points(scene), known.ball_centre(scene.ground)
    light = centre + known.light_direction(scene.ground, azimuth, elevation) * distance * SIZE
    to_light, to_ball = light - points, centre - points
    far = np.linalg.norm(to_light, axis=-1)
    near = np.maximum(np.linalg.norm(to_ball, axis=-1), known.RADIUS)
    cosine = np.einsum("hwc,hwc->hw", to_light, to_ball) / (far * np.linalg.norm(to_ball, axis=-1))
    light_angle, ball_angle = np.arcsin(radius * SIZE / far), np.arcsin(known.RADIUS / near)
    overlap = known.cap_overlap(light_angle, ball_angle, np.arccos(np.clip(cosine, -1, 1)))
    return overlap / (2 * np.pi * (1 - np.cos(light_angle)))


def test_directional_light_with_an_angular_radius():
    """The sun's penumbra: over the angle, not over a length."""
    scene = known.ball_scene(160)
    shadow = cast_shadow(scene, Light(150, 50, radius=4.0, distance=None))
    points, centre = known.floor_points(scene), known.ball_centre(scene.ground)
    towards = known.light_direction(scene.ground, 150, 50)
    to_ball = centre - points
    near = np.linalg.norm(to_ball, axis=-1)
    apart = np.arccos(np.clip(to_ball @ towards / near, -1, 1))
    ball = np.arcsin(np.minimum(known.RADIUS / near, 1))
    sun = np.deg2rad(4.0)
    wanted = known.cap_overlap(sun, ball, apart) / (2 * np.pi * (1 - np.cos(sun)))
    free = seen(scene, margin=1)
    assert np.abs(shadow - wanted)[free].mean() < 0.003
    assert np.abs(shadow - wanted)[free].max() < 0.1


def test_umbra_ends_where_the_geometry_says():
    """A light wider than the ball has a finite umbra; one twice as far away has a longer one."""
    scene = known.ball_scene(200)

    def umbra(radius, distance):
        dark = cast_shadow(scene, Light(180, 30, radius=radius, distance=distance)) > 0.99
        return dark[seen(scene, margin=1)].sum()

    assert umbra(0.2, 10.0) > umbra(1.0, 10.0) > umbra(2.0, 10.0)
    assert umbra(1.0, 20.0) > umbra(1.0, 10.0)


def test_more_samples_come_closer():
    scene = known.ball_scene(96)
    wanted = round_light_shadow(scene, 135, 45, 1.5, 8.0)
    free = seen(scene, margin=1)
    errors = [
        np.abs(cast_shadow(scene, Light(135, 45, 1.5, 8.0), samples=n) - wanted)[free].mean()
        for n in (4, 16, 64, 256)
    ]
    assert errors[0] > 1.5 * errors[1] > errors[2]
    assert errors[3] <= 1.2 * errors[2]
