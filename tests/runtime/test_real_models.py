"""Models that nobody here made, and another renderer's maps of them, where they lie beside."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from support.rooms import room

from spotlight_runtime import Scene
from spotlight_runtime.composing.compose import compose
from spotlight_runtime.composing.gbuffer import render_gbuffer
from spotlight_runtime.composing.posing import Placement, pose_product
from spotlight_runtime.composing.product_files import load_product
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground

REAL = Path(__file__).parents[2].parent / "shared/real"
MODELS = sorted(REAL.glob("models/*/*.gltf"))

pytest.importorskip("embreex", reason="ray casting needs the extra scene")
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not MODELS, reason="needs ../shared/real/models beside the repository"),
]


@pytest.mark.parametrize("path", MODELS, ids=lambda p: p.stem)
def test_model_stands_in_a_room(path):
    product = load_product(path)
    scene = compose(room(240, 180), product, Placement((0.5, 0.75), 30.0, size=0.8))
    assert 0.01 < scene.object_mask.mean() < 0.5
    solid = scene.object_mask == 1.0
    length = np.linalg.norm(scene.object_maps.normal[solid], axis=-1)
    np.testing.assert_allclose(length, 1.0, atol=1e-3)
    assert (scene.footprint_depth > 0.0).any()
    assert scene.object_maps.albedo[solid].max() <= 1.0
    assert scene.object_maps.albedo[solid].mean() > 0.005


def test_sofa_has_its_variants():
    sofa = next(path for path in MODELS if path.stem == "GlamVelvetSofa")
    brightness = {}
    for variant in ("Champagne", "Navy", "Gray", "Black", "Pale Pink"):
        product = load_product(sofa, variant)
        brightness[variant] = max(sum(m.base_colour[:3]) for m in product.materials[1:2])
    assert len(set(brightness.values())) == 4  # navy and black are black in base colour
    assert brightness["Pale Pink"] > brightness["Gray"] > brightness["Black"]
    with pytest.raises(InvalidInputError, match="Champagne, Navy, Gray, Black, Pale Pink"):
        load_product(sofa, "Chartreuse")


@pytest.mark.parametrize(
    ("name", "yaw"),
    [
        ("studio_small_03_1k_WaterBottle_044", 146.1),
        ("lebombo_1k_couch_042", 309.1),
        ("empty_warehouse_01_1k_armchair_pillows_041", 45.3),
    ],
)
def test_maps_agree_with_another_renderers(name, yaw):
    """The test set was path-traced from the same models; the yaw, which it does not say, fits."""
    folder = REAL / "testset" / name
    told = json.loads((folder / "meta.json").read_text())
    truth = Scene.load(folder)
    camera = Camera(384, 384, told["fov"])
    pitch, height = math.radians(told["camera"]["pitch"]), told["camera"]["height"]
    ground = Ground((0.0, math.cos(pitch), math.sin(pitch)), -height)
    x, y, _ = told["object"]["position"]
    foot = np.array([x, told["camera"]["distance"] + y, -height]) @ ground.world_axes()
    column, row, _ = camera.project(foot[None])[0]
    product = load_product(next(p for p in MODELS if p.name == told["model"]))
    placement = Placement((column / 384, row / 384), yaw, size=told["object"]["height"])
    buffer = render_gbuffer(pose_product(product, placement, camera, ground), camera)
    ours, theirs = buffer.mask > 0.5, truth.object_mask > 0.5
    assert (ours & theirs).sum() / (ours | theirs).sum() > 0.99
    both = (buffer.mask > 0.99) & (truth.object_mask > 0.99)
    normal = truth.object_maps.normal[both]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((buffer.maps.normal[both] * normal).sum(axis=1), -1, 1)))
    assert np.median(angle) < 0.5
    assert np.percentile(angle, 90) < 4.0
    depth = (
        np.abs(buffer.maps.depth - truth.object_maps.depth)[both] / truth.object_maps.depth[both]
    )
    assert np.percentile(depth, 95) < 0.005
    assert np.abs(buffer.maps.albedo - truth.object_maps.albedo)[both].mean() < 0.01
    assert np.abs(buffer.maps.roughness - truth.object_maps.roughness)[both].mean() < 0.01
