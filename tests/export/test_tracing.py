"""The trace obeys its contract, or says where it failed."""

from __future__ import annotations

import numpy as np
import onnx
import onnx_ir as ir
import pytest
import torch
from torch import nn
from torch.nn.functional import interpolate

from spotlight_export.errors import TraceError, UnsupportedArchitectureError
from spotlight_export.export import export_backbone
from spotlight_export.networks import _PlainUpsampling
from spotlight_export.sessions import open_graph
from spotlight_export.tracing import EXTERNAL_DATA_ABOVE, save_graph, trace
from spotlight_spec import GraphContract, TensorSpec

SHAPE = ("batch", 4, "latent_height", "latent_width")
CONTRACT = GraphContract(
    "vae_decoder",
    (TensorSpec("latents", "float32", SHAPE, ""),),
    (TensorSpec("image", "float32", SHAPE, ""),),
)
EXAMPLE = (torch.zeros(2, 4, 10, 14),)


class Function(nn.Module):
    def __init__(self, function):
        super().__init__()
        self.function = function

    def forward(self, x):
        return self.function(x)


def test_an_operator_without_onnx_form_is_named():
    with pytest.raises(TraceError, match="airy_ai") as caught:
        trace(Function(torch.special.airy_ai), EXAMPLE, CONTRACT)
    assert "vae_decoder" in str(caught.value)
    assert "torch 2.13" in str(caught.value)


def test_a_network_that_looks_at_its_values_is_refused():
    with pytest.raises(TraceError, match="vae_decoder: tracing failed"):
        trace(Function(lambda x: x if x.sum() > 0 else -x), EXAMPLE, CONTRACT)


def test_a_baked_size_is_refused():
    with pytest.raises(TraceError, match="dimension 2 of 'image' was traced as 8"):
        trace(Function(lambda x: x[:, :, :8]), EXAMPLE, CONTRACT)


def test_a_slice_copies_what_it_takes_and_nothing_else(tmp_path):
    def network(x):
        return torch.cat([x[:, 2:], x[:, :2]], dim=1)

    model = trace(Function(network), EXAMPLE, CONTRACT)
    assert [node.op_type for node in model.graph].count("Slice") == 2
    save_graph(model, tmp_path / "graph.onnx")
    x = np.random.default_rng(0).standard_normal((1, 4, 3, 5), np.float32)
    got = open_graph(tmp_path / "graph.onnx")(latents=x)["image"]
    np.testing.assert_array_equal(got, np.concatenate([x[:, 2:], x[:, :2]], axis=1))


def test_wrong_number_of_outputs_is_refused():
    with pytest.raises(TraceError, match="2 outputs"):
        trace(Function(lambda x: (x + 1, x + 2)), EXAMPLE, CONTRACT)


@pytest.mark.parametrize("flatten", [False, True])
def test_group_norm_is_one_kernel_and_exact(flatten, tmp_path):
    norm = nn.GroupNorm(2, 4, eps=1e-3)
    nn.init.normal_(norm.weight)
    nn.init.normal_(norm.bias)
    network = Function((lambda x: norm(x.flatten(2)).reshape(x.shape)) if flatten else norm)
    network.norm = norm  # so that its parameters are the network's
    save_graph(trace(network, EXAMPLE, CONTRACT), tmp_path / "norm.onnx")
    kinds = {node.op_type for node in onnx.load(tmp_path / "norm.onnx").graph.node}
    assert "InstanceNormalization" in kinds
    assert "GroupNormalization" not in kinds
    x = torch.randn(3, 4, 5, 7)
    got = open_graph(tmp_path / "norm.onnx")(latents=x.numpy())["image"]
    np.testing.assert_allclose(got, network(x).detach().numpy(), atol=1e-5)


def test_repeating_and_cropping_is_nearest_interpolation():
    repeat = _PlainUpsampling(nn.Identity())
    for side in range(1, 40):
        x = torch.randn(1, 1, side, side + 1)
        for size in ((2 * side, 2 * side + 2), (2 * side - 1, 2 * side + 1)):
            assert torch.equal(repeat(x, size), interpolate(x, size=size, mode="nearest"))


@pytest.mark.parametrize("large", [False, True])
def test_large_weights_go_beside_the_graph(large, tmp_path):
    rows = EXTERNAL_DATA_ABOVE // 4096 + (1 if large else -1)
    model = trace(Linear(rows), (torch.zeros(2, 4, 10, 14),), CONTRACT)
    save_graph(model, tmp_path / "graph.onnx")
    assert (tmp_path / "graph.onnx.data").exists() == large
    assert open_graph(tmp_path / "graph.onnx")(latents=np.ones((1, 4, 2, 2), np.float32))


class Linear(nn.Module):
    """Adds the mean of ``rows`` × 4 KiB of weights."""

    def __init__(self, rows):
        super().__init__()
        self.register_buffer("weight", torch.ones(rows, 1024))

    def forward(self, x):
        return x + self.weight.mean()


def test_weights_are_stored_as_the_product_reads_them(fused):
    graph = ir.load(fused / "denoiser.onnx").graph
    for node in graph:
        if node.op_type == "Transpose":
            assert not node.inputs[0].is_initializer()


def test_another_conditioning_layout_has_its_own_builder(checkpoint, tmp_path):
    with pytest.raises(UnsupportedArchitectureError, match="latent_concat"):
        export_backbone("mini", checkpoint.base, checkpoint.controlnet, tmp_path / "out")
