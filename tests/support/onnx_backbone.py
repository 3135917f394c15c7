"""A tiny backbone written with onnx alone, for tests that must run where torch is not installed.

It has random weights and the real contract: four graphs, dynamic sizes, a manifest with checksums.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from spotlight_spec import (
    BACKBONES,
    BackboneSpec,
    FileEntry,
    GraphContract,
    Manifest,
    Source,
    graph_contracts,
    sha256_of,
)

OPSET = 20
CONDITION_CHANNELS = 6
TYPES = {"float32": TensorProto.FLOAT, "int64": TensorProto.INT64}


def tiny_spec(backbone: str = "zerocomp-openrooms", steps: int = 4) -> BackboneSpec:
    """A published spec with few steps."""
    spec = BACKBONES[backbone]
    return replace(spec, schedule=replace(spec.schedule, steps=steps), size=96)


def write_backbone(
    folder: Path,
    spec: BackboneSpec | None = None,
    seed: int = 0,
    gain: float = 1.0,
    hidden: int = 8,
    deep: bool = False,
) -> Path:
    """Write a model folder.

    ``gain`` scales the denoiser's output (infinity makes it overflow), ``hidden`` is its width:
    with thousands of channels its evaluations are what a relight takes its time for. With ``deep``
    it also brings a shallow graph.
    """
    spec = spec or tiny_spec()
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    contracts = graph_contracts(
        spec, condition_channels=CONDITION_CHANNELS, deep_channels=hidden if deep else 0
    )
    makers = {
        "vae_encoder": _vae_encoder,
        "condition_encoder": _condition_encoder,
        "denoiser": partial(_denoiser, hidden=hidden),
        "vae_decoder": _vae_decoder,
    }
    outermost: dict[str, np.ndarray] = {}
    for contract in contracts:
        if contract.name == "denoiser_shallow":
            save_graph(folder, contract, _shallow(), outermost)
            continue
        nodes, weights = makers[contract.name](spec, rng)
        if contract.name == "denoiser":
            weights["out_w"] = weights["out_w"] * np.float32(gain)
            if deep:
                outermost = {"out_w": weights["out_w"], "own_w": np.float32(0.1)}
                weights |= outermost
                nodes[-2:] = [helper.make_node("Tanh", ["z"], ["deep"]), *_shallow()]
        save_graph(folder, contract, nodes, weights)
    manifest = Manifest(
        backbone=spec,
        graphs=contracts,
        layout="fused",
        precision="fp32",
        opset=OPSET,
        files=tuple(
            FileEntry(path.name, path.stat().st_size, sha256_of(path))
            for path in sorted(folder.glob("*.onnx"))
        ),
        source=Source(base="random", controlnet=None, fingerprint="0" * 64),
        exporter={"onnx": onnx.__version__},
    )
    manifest.write(folder)
    return folder


def save_graph(
    folder: Path,
    contract: GraphContract,
    nodes: list[onnx.NodeProto],
    weights: dict[str, np.ndarray],
) -> None:
    """Write one graph with the inputs and outputs of its contract."""
    inputs, outputs = (
        [helper.make_tensor_value_info(t.name, TYPES[t.dtype], t.shape) for t in tensors]
        for tensors in (contract.inputs, contract.outputs)
    )
    initializers = [numpy_helper.from_array(np.asarray(w), name) for name, w in weights.items()]
    graph = helper.make_graph(nodes, contract.name, inputs, outputs, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)])
    model.ir_version = 10
    onnx.checker.check_model(model)
    onnx.save(model, folder / contract.file_name)


def _patchify(rng: np.random.Generator, channels: int, out: int, size: int) -> np.ndarray:
    scale = 1.0 / np.sqrt(channels * size * size)
    return rng.normal(0.0, scale, (out, channels, size, size)).astype(np.float32)


def _vae_encoder(spec: BackboneSpec, rng: np.random.Generator):
    s, c = spec.latent.downscale, spec.latent.channels
    nodes = [
        helper.make_node("Conv", ["image", "w"], ["moments"], strides=[s, s], kernel_shape=[s, s]),
        helper.make_node("Split", ["moments"], ["latent_mean", "log_std"], axis=1, num_outputs=2),
        helper.make_node("Exp", ["log_std"], ["latent_std"]),
    ]
    return nodes, {"w": 3.0 * _patchify(rng, 3, 2 * c, s)}


def _condition_encoder(spec: BackboneSpec, rng: np.random.Generator):
    s = spec.latent.downscale
    nodes = [
        helper.make_node("Conv", ["conditioning", "w"], ["x"], strides=[s, s], kernel_shape=[s, s]),
        helper.make_node("Tanh", ["x"], ["condition"]),
    ]
    return nodes, {"w": _patchify(rng, spec.conditioning_channels, CONDITION_CHANNELS, s)}


def _denoiser(spec: BackboneSpec, rng: np.random.Generator, hidden: int):
    c = spec.latent.channels
    nodes = [
        helper.make_node("Concat", ["latents", "condition"], ["x"], axis=1),
        helper.make_node("Conv", ["x", "in_w"], ["y"], pads=[1, 1, 1, 1], kernel_shape=[3, 3]),
        helper.make_node("Cast", ["timestep"], ["t"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["t", "t_w"], ["bias"]),
        helper.make_node("Add", ["y", "bias"], ["z"]),
        helper.make_node("Tanh", ["z"], ["h"]),
        helper.make_node(
            "Conv", ["h", "out_w"], ["prediction"], pads=[1, 1, 1, 1], kernel_shape=[3, 3]
        ),
    ]
    weights = {
        "in_w": _patchify(rng, c + CONDITION_CHANNELS, hidden, 3),
        "t_w": rng.normal(0.0, 1e-3, (1, hidden, 1, 1)).astype(np.float32),
        "out_w": _patchify(rng, hidden, c, 3),
    }
    return nodes, weights


def _shallow() -> list[onnx.NodeProto]:
    """From deep features and latents to the prediction."""
    return [
        helper.make_node("Conv", ["deep", "out_w"], ["u"], pads=[1, 1, 1, 1], kernel_shape=[3, 3]),
        helper.make_node("Mul", ["latents", "own_w"], ["own"]),
        helper.make_node("Add", ["u", "own"], ["prediction"]),
    ]


def _vae_decoder(spec: BackboneSpec, rng: np.random.Generator):
    s, c = spec.latent.downscale, spec.latent.channels
    nodes = [
        helper.make_node(
            "ConvTranspose", ["latents", "w"], ["x"], strides=[s, s], kernel_shape=[s, s]
        ),
        helper.make_node("Tanh", ["x"], ["image"]),
    ]
    return nodes, {"w": (0.5 * rng.normal(size=(c, 3, s, s))).astype(np.float32)}
