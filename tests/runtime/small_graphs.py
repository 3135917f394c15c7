"""One-node ONNX graphs and their contracts, for tests of sessions."""

from __future__ import annotations

from pathlib import Path

import onnx
from onnx import TensorProto, helper

from spotlight_spec import GraphContract, TensorSpec

PLANE = ("batch", 4, "latent_height", "latent_width")


def tensor(name: str, dtype: str = "float32", shape: tuple[int | str, ...] = PLANE) -> TensorSpec:
    return TensorSpec(name, dtype, shape, "")


FACTORS = (tensor("x"), tensor("y"))
PRODUCT = (tensor("product"),)


def contract(inputs=FACTORS, outputs=PRODUCT) -> GraphContract:
    return GraphContract("unet", tuple(inputs), tuple(outputs))


def write_product(folder: Path, shape=PLANE, names=("x", "y", "product"), dtype="float32") -> Path:
    """Write ``unet.onnx``: the product of its two inputs."""
    kind = {"float32": TensorProto.FLOAT, "int64": TensorProto.INT64, "double": TensorProto.DOUBLE}
    infos = [helper.make_tensor_value_info(n, kind[dtype], shape) for n in names]
    node = helper.make_node("Mul", list(names[:2]), [names[2]])
    graph = helper.make_graph([node], "product", infos[:2], infos[2:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)])
    model.ir_version = 10
    onnx.save(model, folder / "unet.onnx")
    return folder
