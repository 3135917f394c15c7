"""Object generators: finite, closed, facing outwards, and standing where they should."""

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the data renderer needs the training packages")

from spotlight_training.render import kinds
from spotlight_training.render.assemble import SINK, assemble, item_shape
from spotlight_training.render.mesh import bounds, rest_and_scale
from spotlight_training.render.scenes import describe
from spotlight_training.render.solids import ellipsoid, rounded_box

ALL_KINDS = sorted(kind for split in kinds.OBJECT_KINDS.values() for kind in split)


@pytest.mark.parametrize("kind", ALL_KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_generated_objects_are_closed_and_stand_on_the_ground(kind, seed):
    shape = rest_and_scale(kinds.generator(kind)(np.random.default_rng(seed)), 0.8)
    low, high = bounds(shape)
    assert (high - low).max() == pytest.approx(0.8)
    assert low[2] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose((low + high)[:2], 0.0, atol=1e-9)
    total, volume = np.zeros(3), 0.0
    for part in shape:
        corners = part.vertices[part.faces]
        assert np.isfinite(corners).all()
        assert np.isfinite(part.uv).all()
        np.testing.assert_allclose(np.linalg.norm(part.normals, axis=1), 1.0, atol=1e-6)
        area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        total += area.sum(axis=0)
        volume += np.einsum("ij,ij->i", corners[:, 0], area).sum() / 3
        # A face and the normals of its corners look the same way, or shading would be inside out.
        # Leaves are the exception: so thin that a smoothed rim may lean over.
        agree = np.einsum("ij,ij->i", area, part.normals[part.faces].sum(axis=1)) > 0
        assert agree.mean() > (0.8 if kind == "plant" else 0.999)
    # The area vectors of a closed surface cancel; a plant's leaves are open tubes.
    assert np.abs(total).max() < (0.05 if kind == "plant" else 1e-6)
    assert volume > 0


def test_known_volumes():
    def volume(shape):
        total = 0.0
        for part in shape:
            a, b, c = part.vertices[part.faces].transpose(1, 0, 2)
            total += np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        return total

    assert volume(ellipsoid((1.0, 1.0, 1.0), segments=96)) == pytest.approx(4 / 3 * np.pi, rel=5e-3)
    assert volume(rounded_box((1.0, 2.0, 3.0), 1e-4)) == pytest.approx(6.0, rel=1e-3)


def test_a_scene_keeps_its_subject_on_its_support_and_its_uv_in_the_atlas():
    for seed in range(4):
        scene = describe("train", seed)
        low, _ = bounds(item_shape(scene.subject))
        assert low[2] == pytest.approx(scene.support_height - SINK)
        assembly = assemble(scene)
        for geometry in (assembly.background, assembly.subject):
            assert geometry.uv.min() >= 0.0
            assert geometry.uv.max() <= 1.0
            assert geometry.faces.max() < len(geometry.vertices)
        assert assembly.atlas[..., :3].min() >= 0.01
        assert assembly.atlas[..., :3].max() <= 0.95


def test_an_unknown_kind_is_named():
    with pytest.raises(KeyError, match="got 'teapot'"):
        kinds.generator("teapot")
