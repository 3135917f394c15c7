"""Exported graphs compute what diffusers' published forward passes compute."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from support.checkpoints import Checkpoint

from spotlight_export.cases import Case, expectation
from spotlight_export.checkpoint import open_checkpoint
from spotlight_export.reference import DenoiserReference, VaeReference
from spotlight_export.sessions import LEVELS, open_graph
from spotlight_export.tracing import OPSET
from spotlight_spec import Manifest, graph_contracts

TOLERANCE = 1e-4
SIZES = ((8, 12), (33, 47))
GRAPHS = {
    "fused": ("vae_encoder", "vae_decoder", "condition_encoder", "denoiser"),
    "split": ("controlnet", "unet"),
}


@pytest.fixture(scope="module")
def reference(checkpoint: Checkpoint) -> tuple[VaeReference, DenoiserReference]:
    opened = open_checkpoint(str(checkpoint.base), str(checkpoint.controlnet))
    return VaeReference(opened), DenoiserReference(opened)


def relative_error(got: dict, expected: dict) -> float:
    return max(np.abs(got[k] - v).max() / np.abs(v).max() for k, v in expected.items())


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    ("layout", "graph"), [(layout, graph) for layout, names in GRAPHS.items() for graph in names]
)
def test_every_graph_matches_torch(layout, graph, size, reference, request):
    folder = request.getfixturevalue(layout)
    spec = Manifest.read(folder).backbone
    network = open_graph(folder / f"{graph}.onnx")
    rng = np.random.default_rng(0)
    for batch, timestep in ((1, 999), (2, 0)):
        case = Case(size, batch, timestep)
        expected = expectation(graph, case, spec, *reference, rng)
        assert relative_error(network(**expected.inputs), expected.outputs) < TOLERANCE, case


@pytest.mark.parametrize("level", LEVELS)
def test_every_optimisation_level_matches_torch(level, fused, reference):
    spec = Manifest.read(fused).backbone
    network = open_graph(fused / "denoiser.onnx", level)
    expected = expectation(
        "denoiser", Case((5, 9), 3, 499), spec, *reference, np.random.default_rng(1)
    )
    assert relative_error(network(**expected.inputs), expected.outputs) < TOLERANCE


def test_split_equals_fused(fused: Path, split: Path):
    rng = np.random.default_rng(2)
    noisy = {
        "latents": rng.standard_normal((2, 4, 9, 7), np.float32),
        "timestep": np.array([999]),
        "condition": rng.standard_normal((2, 32, 9, 7), np.float32),
    }
    whole = open_graph(fused / "denoiser.onnx")(**noisy)["prediction"]
    residuals = open_graph(split / "controlnet.onnx")(**noisy)
    del noisy["condition"]
    parts = open_graph(split / "unet.onnx")(**noisy, **residuals)["prediction"]
    np.testing.assert_allclose(parts, whole, atol=1e-5 * np.abs(whole).max())


@pytest.mark.parametrize("layout", ["fused", "split"])
def test_files_say_what_their_contract_says(layout, request):
    folder = request.getfixturevalue(layout)
    manifest = Manifest.read(folder)
    channels = (32, 32, 32, 64, 64, 64, 64) if layout == "split" else ()
    by_name = {
        contract.name: contract
        for contract in graph_contracts(
            manifest.backbone, condition_channels=32, residual_channels=channels
        )
    }
    assert {contract.name: contract for contract in manifest.graphs} == by_name
    for contract in manifest.graphs:
        model = onnx.load(folder / contract.file_name)
        onnx.checker.check_model(model, full_check=True)
        assert [entry.version for entry in model.opset_import if not entry.domain] == [OPSET]
        for values, tensors in (
            (model.graph.input, contract.inputs),
            (model.graph.output, contract.outputs),
        ):
            shapes = {
                value.name: tuple(
                    d.dim_param or d.dim_value for d in value.type.tensor_type.shape.dim
                )
                for value in values
            }
            assert shapes == {tensor.name: tensor.shape for tensor in tensors}


def test_graphs_hold_standard_operators_and_no_trace_of_the_machine(fused: Path):
    model = onnx.load(fused / "denoiser.onnx")
    assert {node.domain for node in model.graph.node} == {""}
    assert not model.metadata_props
    assert not any(node.metadata_props or node.doc_string for node in model.graph.node)


def test_the_prompt_is_folded_away(fused: Path):
    names = [t.name for t in onnx.load(fused / "denoiser.onnx").graph.initializer]
    assert any("attn2.processor.keys" in name for name in names)
    assert not any("attn2.to_k" in name or "attn2.to_v" in name for name in names)
