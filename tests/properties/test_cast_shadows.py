"""What holds of every shadow that is cast: neither metres nor the size of everything matter."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("embreex", reason="casting shadows needs the extra scene")

from support.shadow_scenes import ball_scene

from properties.scenes import FEW
from spotlight_runtime import Light
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.shadows.shadow import ShadowCaster

SCENE = ball_scene(48)
LIGHTS = st.builds(
    Light,
    azimuth=st.floats(0.0, 360.0),
    elevation=st.floats(20.0, 80.0),
    radius=st.sampled_from([0.0, 0.5, 1.0]),
    distance=st.sampled_from([4.0, 10.0, None]),
)


def in_other_units(factor):
    """The same place, measured otherwise; a light's distance is in sizes of the object."""
    factor = np.float32(factor)
    return replace(
        SCENE,
        background_maps=replace(SCENE.background_maps, depth=factor * SCENE.background_maps.depth),
        object_maps=replace(SCENE.object_maps, depth=factor * SCENE.object_maps.depth),
        object_mesh=ObjectMesh(factor * SCENE.object_mesh.vertices, SCENE.object_mesh.faces),
        ground=replace(SCENE.ground, offset=float(factor) * SCENE.ground.offset),
    )


@FEW
@given(LIGHTS, st.integers(-6, 6))
def test_powers_of_two_change_no_bit(light, power):
    """Floating point scales by them without rounding, so a length in metres would show at once."""
    wanted = ShadowCaster(SCENE).cast(light).shadow
    np.testing.assert_array_equal(
        ShadowCaster(in_other_units(2.0**power)).cast(light).shadow, wanted
    )


@FEW
@given(LIGHTS, st.floats(0.01, 100.0))
def test_units_of_depth_do_not_matter(light, factor):
    """But for rays that just meet an edge: rounding sends a few past it."""
    wanted = ShadowCaster(SCENE).cast(light).shadow
    difference = np.abs(ShadowCaster(in_other_units(factor)).cast(light).shadow - wanted)
    assert difference.mean() < 2e-3
    assert (difference > 0.05).mean() < 5e-3
