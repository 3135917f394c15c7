"""Real scenes in the published layout, where they lie beside the repository."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime.scene_comparison import arrays_of
from spotlight_runtime import Scene, read_image
from spotlight_runtime.diffusion.conditioning import align_depth, conditioning_array, masked_region
from spotlight_runtime.imaging.colour import linear_to_srgb
from spotlight_spec import BACKBONES

TESTSET = Path(__file__).parents[2].parent / "shared/real/testset"
FOLDERS = sorted(p for p in TESTSET.glob("*") if p.is_dir())

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not FOLDERS, reason="needs ../shared/real/testset beside the repository"),
]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: p.name)
def test_real_scene_loads_with_every_map_it_has(folder):
    scene = Scene.load(folder)
    expected = {"background", "object_mask", "footprint_depth", "truth"}
    expected |= {f"object {n}" for n in ("albedo", "normal", "depth", "roughness", "metallic")}
    expected |= {f"background {n}" for n in ("albedo", "normal", "depth")}
    assert set(arrays_of(scene)) == expected
    assert 0.01 < scene.object_mask.mean() < 0.5
    touching = scene.footprint_depth > 0
    assert touching.any()
    floor = scene.background_maps.depth
    m, c = align_depth(scene.object_maps.depth, scene.object_mask, floor, scene.footprint_depth)
    assert 0.5 < m < 2.0
    aligned = m * scene.footprint_depth[touching] + c
    error = np.abs(aligned - scene.background_maps.depth[touching])
    assert error.mean() < 0.05 * scene.background_maps.depth[touching].mean()


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: p.name)
def test_real_scene_conditions_the_published_backbone(folder):
    spec = BACKBONES["zerocomp-openrooms"]
    shadow = read_image(folder / "shadow_positive_gt_dir.png")
    grey = shadow if shadow.ndim == 2 else np.ascontiguousarray(shadow[..., 0])
    array = conditioning_array(spec, Scene.load(folder), grey)
    assert array.shape == (11, 384, 384)
    assert np.isfinite(array).all()
    assert array.min() >= -1.0
    assert array.max() <= 1e3


def test_real_scene_is_relit_and_its_background_kept(relighter, options):
    folder = FOLDERS[0]
    scene = Scene.load(folder)
    shadows = []
    for kind in ("positive", "negative"):
        shadow = read_image(folder / f"shadow_{kind}_gt_dir.png")
        shadows.append(shadow if shadow.ndim == 2 else np.ascontiguousarray(shadow[..., 0]))
    result = relighter.relight(scene, *shadows, replace(options, steps=2))
    assert result.image.shape == (384, 384, 3)
    assert np.isfinite(result.image).all()
    assert (result.image >= 0.0).all()
    assert (result.image <= 1.0).all()
    region = masked_region(shadows[0], scene.object_mask).astype(np.uint8)
    far = cv2.dilate(region, np.ones((17, 17), np.uint8)) == 0
    assert far.mean() > 0.3
    np.testing.assert_array_equal(result.image[far], linear_to_srgb(scene.background)[far])
