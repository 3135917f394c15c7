"""Doubling and a convolution as one transposed convolution: the same sums, only where they are."""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from spotlight_runtime.networks.openvino_fold import fold_upsampling

ov = pytest.importorskip("openvino", reason="needs the extra openvino")

SIDES = (5, 6)


def doubled_convolution(*, kernel=3, crop=0, mode="nearest", factor=2.0, dtype=np.float32):
    """ONNX graph: resize, crop, convolution with bias."""
    rng = np.random.default_rng(4)
    weights = rng.standard_normal((4, 3, kernel, kernel)).astype(dtype)
    height, width = (int(factor * side) - crop for side in SIDES)
    constants = {
        "scales": np.array([1.0, 1.0, factor, factor], np.float32),
        "starts": np.array([0, 0], np.int64),
        "ends": np.array([height, width], np.int64),
        "axes": np.array([2, 3], np.int64),
        "stored": weights,
        "bias": rng.standard_normal(4).astype(np.float32),
    }
    half = kernel // 2
    nodes = [
        helper.make_node(
            "Resize",
            ["x", "", "scales"],
            ["whole"],
            mode=mode,
            coordinate_transformation_mode="asymmetric",
            nearest_mode="floor",
        ),
        helper.make_node("Slice", ["whole", "starts", "ends", "axes"], ["cropped"]),
        helper.make_node("Cast", ["stored"], ["weights"], to=TensorProto.FLOAT),
        helper.make_node("Conv", ["cropped", "weights", "bias"], ["y"], pads=[half] * 4),
    ]
    graph = helper.make_graph(
        nodes,
        "doubled",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, (2, 3, *SIDES))],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, (2, 4, height, width))],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)])
    model.ir_version = 10
    onnx.checker.check_model(model)
    return model.SerializeToString()


def outputs(serialised):
    """What ONNX Runtime computes, what OpenVINO does folded, and how often it was folded."""
    x = np.random.default_rng(5).standard_normal((2, 3, *SIDES)).astype(np.float32)
    session = onnxruntime.InferenceSession(serialised, providers=["CPUExecutionProvider"])
    core = ov.Core()
    model = core.read_model(serialised)
    folded = fold_upsampling(model)
    compiled = core.compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    return session.run(None, {"x": x})[0], compiled({"x": x})["y"], folded


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_folded_it_is_the_same(dtype):
    wanted, got, folded = outputs(doubled_convolution(dtype=dtype))
    assert folded == 1
    np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    "other", [{"crop": 1}, {"kernel": 5}, {"mode": "linear"}, {"factor": 3.0}], ids=str
)
def test_what_cannot_be_folded_stays_as_it_is(other):
    wanted, got, folded = outputs(doubled_convolution(**other))
    assert folded == 0
    np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-5)
