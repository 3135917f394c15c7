"""The runtime's guiding shadows against the path tracer's, on scenes neither was tuned on.

Set SPOTLIGHT_RECORDS to a folder of records to judge those instead of rendering twenty scenes.
"""

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the data renderer needs the training packages")
pytest.importorskip("mitsuba", reason="the path tracer needs mitsuba")
pytest.importorskip("pyoidn", reason="the renderer's pipeline needs pyoidn")
pytest.importorskip("embreex", reason="casting shadows needs the extra `scene`")

from spotlight_training.render.variant import RendererUnavailableError, select_variant

try:
    select_variant("auto", threads=1)
except RendererUnavailableError as error:
    pytest.skip(str(error), allow_module_level=True)

from support.rendered_scenes import light_of, render_records, scene_of

from spotlight_runtime.shadows.placement import box_of
from spotlight_runtime.shadows.shadow import ShadowCaster, floor_of
from spotlight_training.render.record import SUFFIX, SceneRecord

SCENES = 20
DARK = 0.9
"""Umbra: where the light is gone but for the renderer's noise."""
LEAST_PIXELS = 100
"""Smaller umbras are slivers at the object's foot, whose outline is all they have."""


def compare(record):
    """Umbra in both and in either, and the mean absolute error, of every light of a record."""
    scene = scene_of(record)
    size = box_of(scene.object_mesh, floor_of(scene)).size
    caster, seen = ShadowCaster(scene), 1.0 - record.object.alpha
    rows = []
    for name, true in record.shadows.items():
        got, wanted = caster.cast(light_of(record, name, size)).shadow, true * seen
        beside = seen > 0.5
        ours, theirs = (got > DARK * seen)[beside], (wanted > DARK * seen)[beside]
        rows.append(((ours & theirs).sum(), (ours | theirs).sum(), np.abs(got - wanted).mean()))
    return np.array(rows)


def judge(records, capsys):
    """One line a scene; returns their intersections over unions and largest mean errors."""
    ious, errors = [], []
    for path in records:
        record = SceneRecord.load(path)
        rows = compare(record)
        errors.append(rows[:, 2].max())
        told = "–"
        if rows[:, 1].sum() >= LEAST_PIXELS:
            ious.append(rows[:, 0].sum() / rows[:, 1].sum())
            told = f"{ious[-1]:.3f}"
        with capsys.disabled():
            kind = record.description.subject.kind
            print(f"{path.name} {kind}: IoU {told}, error {errors[-1]:.4f}")
    with capsys.disabled():
        print(
            f"{len(ious)} scenes: IoU mean {np.mean(ious):.3f}, median {np.median(ious):.3f}, "
            f"worst {np.min(ious):.3f}; mean absolute error mean {np.mean(errors):.4f}, "
            f"worst {np.max(errors):.4f}"
        )
    return np.array(ious), np.array(errors)


@pytest.mark.full
def test_umbra_and_error_on_held_out_scenes(tmp_path, capsys):
    given = os.environ.get("SPOTLIGHT_RECORDS")
    if given:
        records = sorted(Path(given).rglob(f"*{SUFFIX}"))[:100]
        assert len(records) >= SCENES
    else:
        records = render_records(tmp_path, range(SCENES + 2))
    ious, errors = judge(records, capsys)
    assert len(ious) >= SCENES
    assert errors.max() <= 0.05
    assert ious.mean() >= 0.9
    assert (ious >= 0.9).mean() >= 0.85


def test_a_small_scene_agrees(tmp_path, capsys):
    """The same with one scene at a quarter of the size, cheap enough for every day."""
    ious, errors = judge(render_records(tmp_path, range(3, 4), side=128, spp=16), capsys)
    assert ious.min() > 0.85
    assert errors.max() < 0.01
