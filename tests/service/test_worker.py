"""A worker whose model cannot be run."""

from __future__ import annotations

import logging

import pytest
from support.onnx_backbone import tiny_spec

from spotlight_runtime import Relighter
from spotlight_runtime.errors import ModelError
from spotlight_service.engine.worker import Bench


def test_a_model_that_cannot_be_run_does_not_keep_the_worker_from_its_jobs(caplog):
    """It would be started again and again, and no job would learn what is wrong."""

    def broken(**inputs):
        raise ModelError("condition_encoder.onnx: cannot be run")

    graphs = ("vae_encoder", "condition_encoder", "denoiser", "vae_decoder")
    relighter = Relighter(tiny_spec(), dict.fromkeys(graphs, broken), remember=0)
    with pytest.raises(ModelError):
        relighter.calibrated()
    bench = Bench("w", "tiny", None, None, None, None, relighter, {})
    with caplog.at_level(logging.INFO):
        bench.predict()
    assert bench.plans == {}
    assert [record.message for record in caplog.records] == ["not measured"]
    assert "condition_encoder.onnx: cannot be run" in caplog.text
