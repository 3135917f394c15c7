"""The pinhole camera: rays, points and pixels agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scenes import make_scene

from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.camera import Camera

cameras = st.builds(
    Camera, st.integers(1, 40), st.integers(1, 40), st.floats(5, 150, allow_nan=False)
)


def test_focal_length_of_a_right_angle():
    assert Camera(200, 100, 90.0).focal == pytest.approx(100.0)


def test_rays_point_right_up_and_away():
    rays = Camera(4, 2, 90.0).rays()
    assert rays.dtype == np.float32
    assert rays.shape == (2, 4, 3)
    np.testing.assert_allclose(rays[0, 0], [-0.75, 0.25, -1.0])
    np.testing.assert_allclose(rays[1, 3], [0.75, -0.25, -1.0])


@given(cameras, st.integers(0, 2**32 - 1))
def test_what_is_unprojected_projects_back(camera, seed):
    depth = np.random.default_rng(seed).uniform(0.1, 30, (camera.height, camera.width))
    points = camera.unproject(depth.astype(np.float32))
    assert points.dtype == np.float32
    places = camera.project(points.reshape(-1, 3).astype(np.float64))
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    wanted = np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5, depth.ravel()], axis=1)
    np.testing.assert_allclose(places, wanted, rtol=1e-5, atol=1e-4)


def test_points_beside_and_behind_the_camera_stay_numbers():
    places = Camera(10, 10).project(np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, 2.0]]))
    assert not np.isnan(places).any()
    np.testing.assert_array_equal(places[:, 2], [0.0, 0.0, -2.0])


@pytest.mark.parametrize("arguments", [(0, 4, 50.0), (4, -1, 50.0)])
def test_a_camera_has_pixels(arguments):
    with pytest.raises(InvalidInputError, match="at least one pixel"):
        Camera(*arguments)


@pytest.mark.parametrize("angle", [0.0, 180.0, -20.0, float("nan")])
def test_impossible_field_of_view(angle):
    with pytest.raises(InvalidInputError, match="field_of_view"):
        Camera(4, 4, angle)


def test_a_scene_has_a_camera():
    from dataclasses import replace

    scene = make_scene(12, 16)
    assert scene.camera == Camera(16, 12, 50.0)
    assert replace(scene, field_of_view=None).camera == Camera(16, 12, 50.0)
    assert replace(scene, field_of_view=70.0).camera == Camera(16, 12, 70.0)
