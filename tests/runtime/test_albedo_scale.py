"""An albedo that is right up to a factor, and the renderers that want it right altogether."""

from dataclasses import replace

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow

from runtime.test_published_layout import write_published
from spotlight_runtime import GuidingShadow, Scene
from spotlight_runtime.errors import SceneError
from spotlight_runtime.relighting.preparation import prepare_window
from spotlight_spec import BACKBONES

USUAL = 1.15
GIVEN = BACKBONES["zerocomp-openrooms"]
TOLD = replace(GIVEN, shading=replace(GIVEN.shading, usual_light=USUAL))


def with_albedo(scene, factor, scale="unknown"):
    albedo = np.float32(factor) * scene.background_maps.albedo
    return replace(
        scene,
        background_maps=replace(scene.background_maps, albedo=albedo),
        albedo_scale=scale,
    )


def seen_albedo(spec, scene):
    return prepare_window(spec, scene, [GuidingShadow(make_shadow(scene))]).view.background_maps


@pytest.fixture(scope="module")
def scene():
    return make_scene()


def test_what_scale_an_estimate_has_makes_no_difference(scene):
    seen = [seen_albedo(TOLD, with_albedo(scene, factor)).albedo for factor in (1.0, 0.5, 0.25)]
    for other in seen[1:]:
        np.testing.assert_allclose(seen[0], other, rtol=1e-5)
    light = scene.background.mean(axis=2) / seen[0].mean(axis=2)
    assert np.median(light) == pytest.approx(USUAL, rel=1e-3)


@pytest.mark.parametrize(
    ("spec", "scale"), [(TOLD, "known"), (GIVEN, "unknown")], ids=["reflectance", "published"]
)
def test_an_albedo_is_taken_as_given(scene, spec, scale):
    given = with_albedo(scene, 0.5, scale)
    np.testing.assert_array_equal(seen_albedo(spec, given).albedo, given.background_maps.albedo)


def test_darkness_has_no_scale(scene):
    black = with_albedo(scene, 0.0)
    assert not seen_albedo(TOLD, black).albedo.any()
    night = replace(with_albedo(scene, 1.0), background=np.zeros_like(scene.background))
    np.testing.assert_array_equal(seen_albedo(TOLD, night).albedo, night.background_maps.albedo)


def test_published_sets_have_estimates_unless_they_say_otherwise(tmp_path, scene):
    folder = write_published(tmp_path / "s", scene)
    assert Scene.load(folder).albedo_scale == "unknown"
    (folder / "meta.json").write_text('{"fov": 50}')
    assert Scene.load(folder).albedo_scale == "unknown"
    (folder / "meta.json").write_text('{"maps": "rendered"}')
    assert Scene.load(folder).albedo_scale == "known"
    (folder / "meta.json").write_text("{")
    with pytest.raises(SceneError, match=r"meta\.json: expected a UTF-8 JSON document"):
        Scene.load(folder)


@pytest.mark.parametrize("scale", ["known", "unknown"])
def test_a_bundle_keeps_it(tmp_path, scene, scale):
    with_albedo(scene, 1.0, scale).save(tmp_path / "scene")
    assert Scene.load(tmp_path / "scene").albedo_scale == scale
