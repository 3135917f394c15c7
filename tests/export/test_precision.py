"""fp16 and int8: what is stored how, and how exact it stays."""

from __future__ import annotations

import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper, numpy_helper

from spotlight_export.errors import QuantisationError
from spotlight_export.half import store_weights_as_half
from spotlight_export.quantise import quantise_graph, tensors_to_observe
from spotlight_export.sessions import open_graph
from spotlight_spec import Manifest


def layer(weight: np.ndarray, bias: np.ndarray | None = None) -> ir.Model:
    """``y = x · weight (+ bias)`` as a graph."""
    initializers = [numpy_helper.from_array(weight, "weight")]
    nodes = [helper.make_node("MatMul", ["x", "weight"], ["y" if bias is None else "product"])]
    if bias is not None:
        initializers.append(numpy_helper.from_array(bias, "bias"))
        nodes.append(helper.make_node("Add", ["product", "bias"], ["y"]))
    graph = helper.make_graph(
        nodes,
        "layer",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["n", weight.shape[0]])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, ["n", weight.shape[1]])],
        initializers,
    )
    return ir.from_proto(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 23)], ir_version=10)
    )


def test_half_stores_matrices_as_half_and_vectors_as_float(half):
    types = {
        tensor.name: tensor.data_type
        for tensor in onnx.load(half / "denoiser.onnx").graph.initializer
        if tensor.data_type in (TensorProto.FLOAT, TensorProto.FLOAT16)
    }
    assert all(
        kind == TensorProto.FLOAT16 for name, kind in types.items() if "conv1.weight" in name
    )
    assert all(kind == TensorProto.FLOAT for name, kind in types.items() if name.endswith(".bias"))


@pytest.mark.parametrize("folder", ["fused", "half", "int8"])
def test_sines_of_timesteps_are_a_table_of_floats(folder, request):
    """Of angles up to a thousand, which bfloat16 and half cannot tell from their neighbours."""
    graph = onnx.load(request.getfixturevalue(folder) / "denoiser.onnx").graph
    assert not {"Sin", "Cos"} & {node.op_type for node in graph.node}
    stored = {tensor.name: tensor.data_type for tensor in graph.initializer}
    read = {node.input[0] for node in graph.node if "timestep" in node.input}
    assert read
    assert all(stored[name] == TensorProto.FLOAT for name in read)


def test_bfloat16_is_no_less_exact_where_timesteps_are_large(fused):
    pytest.importorskip("openvino", reason="needs the extra openvino")
    from spotlight_runtime.networks.openvino import open_graph as open_openvino

    contract = Manifest.read(fused).graph("denoiser")
    exact, brief = (
        open_openvino(fused, contract, precision=kind, threads=1) for kind in ("f32", "bf16")
    )
    rng = np.random.default_rng(3)
    inputs = {
        "latents": rng.standard_normal((1, 4, 16, 16), np.float32),
        "condition": rng.standard_normal((1, 32, 16, 16), np.float32),
    }
    errors = {}
    for timestep in (0, 1, 999, 991):
        all_inputs = inputs | {"timestep": np.array([timestep])}
        wanted = exact(**all_inputs)["prediction"]
        got = brief(**all_inputs)["prediction"]
        errors[timestep] = np.linalg.norm(got - wanted) / np.linalg.norm(wanted)
    assert max(errors[999], errors[991]) <= 1.5 * max(errors[0], errors[1]), errors


def test_half_takes_half_the_space(half, fused):
    size = {
        folder: sum(entry.bytes for entry in Manifest.read(folder).files)
        for folder in (half, fused)
    }
    assert size[half] < 0.6 * size[fused]


@pytest.mark.parametrize(("value", "reason"), [(70000.0, "overflows"), (1e-7, "relative error")])
def test_what_half_cannot_hold_stays_float_and_is_named(value, reason):
    weight = np.full((4, 4), 1.1 * value, np.float32)
    model = layer(weight)
    (kept,) = store_weights_as_half(model)
    assert kept.startswith("weight: ")
    assert reason in kept
    np.testing.assert_array_equal(model.graph.initializers["weight"].const_value.numpy(), weight)


def test_half_computes_in_float():
    weight = np.random.default_rng(0).standard_normal((8, 4)).astype(np.float32)
    model = layer(weight, np.ones(4, np.float32))
    assert store_weights_as_half(model) == []
    session = ort.InferenceSession(ir.to_proto(model).SerializeToString())
    x = np.full((1, 8), 1e5, np.float32)  # not representable in half
    (got,) = session.run(None, {"x": x})
    np.testing.assert_allclose(got, x @ weight.astype(np.float16).astype(np.float32) + 1, rtol=1e-5)


@pytest.mark.parametrize(("precision", "tolerance"), [("half", 1e-2), ("int8", 1.5e-1)])
def test_error_stays_within_tolerance_and_is_not_zero(precision, tolerance, fused, request):
    rng = np.random.default_rng(3)
    inputs = {
        "latents": rng.standard_normal((2, 4, 9, 14), np.float32),
        "timestep": np.array([499]),
        "condition": rng.standard_normal((2, 32, 9, 14), np.float32),
    }
    exact = open_graph(fused / "denoiser.onnx")(**inputs)["prediction"]
    folder = request.getfixturevalue(precision)
    stored = open_graph(folder / "denoiser.onnx")(**inputs)["prediction"]
    error = np.abs(stored - exact).max() / np.abs(exact).max()
    assert 1e-5 < error < tolerance


def test_int8_reaches_convolutions_and_linear_layers_and_nothing_else(int8):
    graph = onnx.load(int8 / "denoiser.onnx").graph
    producers = {output: node for node in graph.node for output in node.output}
    quantised = {
        node.op_type
        for node in graph.node
        if node.op_type not in ("QuantizeLinear", "DequantizeLinear")
        and all(
            producers.get(name) is not None and producers[name].op_type == "DequantizeLinear"
            for name in node.input[:2]
        )
        and len(node.input) >= 2
        and {i.name for i in graph.initializer} & set(producers[node.input[1]].input[:1])
    }
    assert quantised == {"Conv", "MatMul"}
    itself, prompt = (
        [node for node in graph.node if node.op_type == kind]
        for kind in ("MultiHeadAttention", "Attention")
    )
    assert len(itself) == len(prompt) > 0
    attention = [*itself, *prompt]
    assert all(
        producers[name].op_type != "DequantizeLinear" for node in attention for name in node.input
    )
    notes = Manifest.read(int8).provenance
    assert "denoiser" in notes["int8 layers"]
    assert notes["float32 graphs"] == "vae_encoder, vae_decoder, condition_encoder"


@pytest.mark.parametrize(
    ("model", "graph", "convolutions"),
    [("int8", "denoiser", 53), ("split_int8", "controlnet", 20), ("split_int8", "unet", 33)],
)
def test_int8_runs_in_integer_kernels(model, graph, convolutions, request, tmp_path):
    path = request.getfixturevalue(model) / f"{graph}.onnx"
    options = ort.SessionOptions()
    options.log_severity_level = 3
    options.optimized_model_filepath = str(tmp_path / "optimised.onnx")
    ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    kinds = [node.op_type for node in onnx.load(options.optimized_model_filepath).graph.node]
    assert kinds.count("QLinearConv") == convolutions
    assert kinds.count("MatMulIntegerToFloat") >= 30
    assert kinds.count("MatMul") == 0


def test_a_linear_layer_is_as_exact_as_eight_bits_allow(tmp_path):
    rng = np.random.default_rng(4)
    weight = rng.standard_normal((64, 32)).astype(np.float32)
    weight[:, 5] = 0.0  # a dead channel has no scale of its own
    model = layer(weight)
    assert tensors_to_observe(model) == ["x"]
    ir.save(model, tmp_path / "float.onnx")
    count = quantise_graph(tmp_path / "float.onnx", tmp_path / "int8.onnx", {"x": (-4.0, 4.0)})
    assert count == 1
    x = rng.uniform(-4, 4, (10, 64)).astype(np.float32)
    got, exact = open_graph(tmp_path / "int8.onnx")(x=x)["y"], x @ weight
    assert np.abs(got - exact).max() < 0.02 * np.abs(exact).max()
    np.testing.assert_array_equal(got[:, 5], 0.0)


def test_ranges_must_be_known_and_finite(tmp_path):
    ir.save(layer(np.ones((32, 32), np.float32)), tmp_path / "float.onnx")
    for ranges in ({}, {"x": (0.0, float("inf"))}):
        with pytest.raises(QuantisationError, match="tensor 'x'"):
            quantise_graph(tmp_path / "float.onnx", tmp_path / "int8.onnx", ranges)


def test_nothing_to_quantise_is_said(tmp_path):
    ir.save(layer(np.ones((4, 4), np.float32)), tmp_path / "float.onnx")
    with pytest.raises(QuantisationError, match="at least 16 channels"):
        quantise_graph(tmp_path / "float.onnx", tmp_path / "int8.onnx", {})
