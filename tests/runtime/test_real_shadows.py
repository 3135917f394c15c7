"""Shadows of the published layout's scenes, cast from reliefs, against those that come with them.

Theirs are cast from the objects' meshes, which the layout does not carry.
"""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")

from spotlight_runtime import Scene, read_image
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.shadows.shadow import ShadowCaster, floor_of

TESTSET = Path(__file__).parents[2].parent / "shared/real/testset"
FOLDERS = sorted(p for p in TESTSET.glob("*") if p.is_dir())
SLIVER = 500
"""Pixels below which a shadow is little more than a line along the object's foot."""

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not FOLDERS, reason="needs ../shared/real/testset beside the repository"),
]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: p.name)
def test_the_floor_is_found(folder):
    camera = json.loads((folder / "meta.json").read_text())["camera"]
    ground = floor_of(Scene.load(folder))
    pitch = np.rad2deg(np.arctan2(ground.normal[2], ground.normal[1]))
    assert pitch == pytest.approx(camera["pitch"], abs=0.1)
    assert -ground.offset == pytest.approx(camera["height"], rel=0.005)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: p.name)
def test_shadows_fall_as_the_meshes_do(folder):
    scene = Scene.load(folder)
    caster, beside = ShadowCaster(scene), scene.object_mask < 0.5
    overlaps = []
    for name, light in json.loads((folder / "meta.json").read_text())["lights"].items():
        theirs = read_image(folder / f"shadow_positive_{name}.png")
        theirs = (theirs if theirs.ndim == 2 else theirs[..., 0]) * (1 - scene.object_mask)
        ours = caster.cast(Light(light["azimuth"], light["elevation"])).shadow
        assert np.abs(ours - theirs).mean() < 0.03
        dark, wanted = (ours > 0.5) & beside, (theirs > 0.5) & beside
        if wanted.sum() >= SLIVER:
            overlaps.append((dark & wanted).sum() / (dark | wanted).sum())
    assert len(overlaps) >= 6
    assert np.mean(overlaps) > 0.7
    assert min(overlaps) > 0.55
