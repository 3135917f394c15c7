"""From an exported model folder back to run folders, to train its weights on.

Graphs carry their networks' weights by name, in the precision they were shipped in. That is enough
to go on: on one's own objects, for longer, on a faster machine.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import onnx
import torch
from onnx import numpy_helper
from torch import nn

from spotlight_runtime.networks.models import resolve_model
from spotlight_training.networks import VAE, IntrinsicsNet
from spotlight_training.runs import new_renderer, renderer_shape, save_run, spec_of

__all__ = ["restore"]

SUFFIXES: Final = ("", ".3d", ".half", ".3d.half")
"""What the exporter adds to a weight's name: for its shape (a group norm's), for its precision."""

BLOCK: Final = re.compile(r"denoiser\.deep\.(\d+)\.")

Weights = dict[str, npt.NDArray[Any]]


def restore(model: str | Path, out: Path) -> tuple[Path, Path, Path]:
    """Write the run folders ``vae``, ``renderer`` and ``intrinsics`` of a model `ship` made.

    Parameters
    ----------
    model : str or Path
        Model folder, or its name, with weights of float32 or float16.
    out : Path
        Folder to create them in.

    Returns
    -------
    tuple of Path
        The three run folders. Each has weights and no checkpoint: a training starts there
        (``--start``), it does not go on with an optimiser's state.

    Raises
    ------
    UnknownModelError
        If there is no such model.
    ValueError
        If the model is not one of this project's trainings, or its weights are int8.
    FileExistsError
        If one of the folders is there already.
    """
    folders = (out / "vae", out / "renderer", out / "intrinsics")
    for folder in folders:
        if folder.exists():
            raise FileExistsError(f"{folder}: expected no such folder; give another --output")
    graphs = _graphs(model)
    autoencoder = graphs["vae_encoder"] | graphs["vae_decoder"]
    latent, width = (
        len(_find(autoencoder, name)) for name in ("vae.analysis.bias", "vae.middle.0.bias")
    )
    shape = {"latent": latent, "width": width}
    vae = _filled(VAE(latent, width), "vae.", autoencoder)
    width = len(_find(graphs["denoiser"], "denoiser.enter.bias"))
    blocks = {match[1] for match in map(BLOCK.match, graphs["denoiser"]) if match}
    renderer = new_renderer(vae, spec_of(shape), width, len(blocks))
    _filled(renderer.condition, "", graphs["condition_encoder"])
    _filled(renderer.denoiser, "denoiser.", graphs["denoiser"] | _variance(graphs, latent))
    estimator = _filled(IntrinsicsNet(), "", graphs["intrinsics"])
    save_run(folders[0], vae, shape)
    save_run(folders[1], renderer, renderer_shape(renderer, shape))
    save_run(folders[2], estimator, {})
    return folders


def _graphs(model: str | Path) -> dict[str, Weights]:
    """Weights of every graph, by their names in it."""
    found = resolve_model(model)
    manifest = found.manifest
    if manifest.source.base != "spotlight-train" or manifest.precision == "int8":
        raise ValueError(
            f"{model}: expected fp32 or fp16 weights that 'spotlight-train export' wrote, it has "
            f"{manifest.precision} weights from {manifest.source.base}; restore such a one"
        )
    return {
        contract.name: {
            tensor.name.removeprefix("network."): numpy_helper.to_array(tensor)
            for tensor in onnx.load(found.path / contract.file_name).graph.initializer
        }
        for contract in manifest.graphs
    }


def _find(weights: Weights, name: str) -> npt.NDArray[Any]:
    for suffix in SUFFIXES:
        if name + suffix in weights:
            return weights[name + suffix]
    raise ValueError(
        f"weight {name!r}: expected in a graph of the model, not there; the model is of another "
        "architecture than this version trains: train from nothing instead"
    )


def _filled(network: nn.Module, prefix: str, weights: Weights) -> Any:
    """``network`` with its weights from a graph."""
    state = {
        name: torch.from_numpy(
            _find(weights, prefix + name).astype(np.float32).reshape(tuple(value.shape))
        )
        for name, value in network.state_dict().items()
    }
    network.load_state_dict(state)
    return network


def _variance(graphs: dict[str, Weights], latent: int) -> Weights:
    """The variance of hidden latents: the one parameter the tracer computes with, its name lost."""
    shape = (1, latent, 1, 1)
    (variance,) = (array for array in graphs["denoiser"].values() if array.shape == shape)
    return {"denoiser.log_variance": np.log(variance.astype(np.float32))}
