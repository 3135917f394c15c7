"""``spotlight-export verify``: numbers into the manifest, exit code 1 past tolerance."""

from __future__ import annotations

import shutil

import pytest
from support.checkpoints import write_tiny_checkpoint

from spotlight_export import cases, verify
from spotlight_export.errors import FingerprintError, ModelFolderError
from spotlight_export.verify import past_tolerance, verify_model
from spotlight_spec import Manifest, ParityRow


@pytest.fixture(autouse=True)
def _small_cases(monkeypatch):
    """The command's own sizes are for real models; these take a second instead of a minute."""
    monkeypatch.setattr(cases, "QUICK_SHAPES", (((8, 12), 1), ((9, 7), 2)))
    monkeypatch.setattr(verify, "LOOP_SIZES", {False: ((9, 8),)})


@pytest.mark.parametrize("model", ["fused", "split", "half", "int8", "split_int8"])
def test_a_fresh_model_is_within_tolerance_and_says_so(model, request, tmp_path):
    folder = tmp_path / model
    shutil.copytree(request.getfixturevalue(model), folder)
    rows = verify_model(folder)
    assert not past_tolerance(rows), past_tolerance(rows)
    manifest = Manifest.read(folder)
    assert manifest.parity == rows
    assert {row.subject for row in rows} == {*(c.name for c in manifest.graphs), "loop"}
    assert not manifest.damaged_files(folder)


def test_other_weights_are_refused(fused, tmp_path):
    other = write_tiny_checkpoint(tmp_path, seed=1)
    with pytest.raises(FingerprintError, match="fingerprint"):
        verify_model(fused, base=str(other.base))


def test_a_folder_without_a_manifest_is_no_model(tmp_path):
    with pytest.raises(ModelFolderError, match="not a model folder"):
        verify_model(tmp_path)


def test_past_tolerance_counts_what_is_not_a_number():
    rows = (
        ParityRow("denoiser", "good", 0.0, 1e-6, 1e-4),
        ParityRow("denoiser", "bad", 0.0, 1e-3, 1e-4),
        ParityRow("denoiser", "nan", 0.0, float("nan"), 1e-4),
    )
    assert [row.case for row in past_tolerance(rows)] == ["bad", "nan"]
