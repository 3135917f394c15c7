"""The three trainings: which data, which network, which objective, and where the result goes.

A run folder is resumable: calling the same function again goes on from its checkpoint. The averaged
weights are saved as ``model.safetensors``; its metadata have the network's shape, and whether the
weights were trained.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional

from spotlight_runtime.diffusion.schedule import alphas_cumprod
from spotlight_spec import BACKBONES, BackboneSpec
from spotlight_training.data import IntrinsicsData, Packed, PictureData, RendererData
from spotlight_training.loop import CHECKPOINT_FILE, TrainingOptions, train
from spotlight_training.networks import PATCH, VAE, ConditionEncoder, Denoiser, IntrinsicsNet
from spotlight_training.objectives import (
    Renderer,
    intrinsics_loss,
    intrinsics_sheet,
    renderer_loss,
    renderer_sheet,
    vae_loss,
    vae_sheet,
)

__all__ = [
    "load_renderer",
    "load_vae",
    "new_renderer",
    "renderer_shape",
    "save_run",
    "spec_of",
    "starting",
    "train_intrinsics",
    "train_renderer",
    "train_vae",
]

MODEL_FILE = "model.safetensors"
NEW_PARTS = ("denoiser.deep.", "denoiser.finder.")
DEPTH = 12
"""Blocks of a new renderer's deep part."""


def train_vae(
    data: Path,
    held_out: Path,
    run: Path,
    options: TrainingOptions,
    *,
    latent: int,
    width: int,
    side: int,
    start: Path | None = None,
) -> None:
    """Fit the VAE's latents to packed pictures and train its decoder; see `TrainingOptions`.

    A new run saves its latents before the decoder is trained: the renderer needs no more to begin.

    Parameters
    ----------
    data, held_out : Path
        Packed scenes of the training and validation splits.
    run : Path
        Folder of the run.
    options : TrainingOptions
    latent, width : int
        Latent channels; channels of the VAE's first level.
    side : int
        Of the training pictures.
    start : Path, optional
        Run whose weights a new run starts from.
    """
    samples = _held_out(PictureData(Packed(held_out)), options.samples)
    network = VAE(latent, width)
    if start is None:
        network.fit_patches(_patches(PictureData(Packed(data))))
    else:
        _load(network, start / MODEL_FILE)
    shape = {"latent": latent, "width": width}
    if not any((run / name).is_file() for name in (CHECKPOINT_FILE, MODEL_FILE)):
        save_run(run, network, shape, trained=False)
    model = train(
        network,
        vae_loss,
        PictureData(Packed(data), side),
        run,
        options,
        vae_sheet(samples, options.device),
    )
    # Without a step there is no checkpoint, and the decoder is as good as the one it started from.
    stepped = (run / CHECKPOINT_FILE).is_file()
    save_run(run, model, shape, trained=stepped or (start is not None and _is_trained(start)))


def train_renderer(
    data: Path,
    held_out: Path,
    vae: Path,
    run: Path,
    options: TrainingOptions,
    *,
    width: int,
    side: int,
    start: Path | None = None,
    depth: int = DEPTH,
) -> None:
    """Train condition encoder and denoiser over a trained VAE.

    Parameters
    ----------
    data, held_out : Path
        Packed scenes of the training and validation splits.
    vae : Path
        Run folder of the VAE.
    run : Path
        Folder of the run.
    options : TrainingOptions
    width : int
        Channels of the renderer at latent size; see `Denoiser`.
    side : int
        Of the training pictures; learning first at half size sees four times as many.
    start : Path, optional
        Run whose weights a new run starts from; it may have fewer blocks.
    depth : int
        Blocks of the renderer's deep part.
    """
    autoencoder, spec = load_vae(vae)
    samples = _held_out(RendererData(Packed(held_out), spec), options.samples)
    network = new_renderer(autoencoder, spec, width, depth)
    if start is not None:
        _grown(network, start / MODEL_FILE)
    model = train(
        network,
        renderer_loss(spec),
        RendererData(Packed(data), spec, side),
        run,
        options,
        renderer_sheet(samples, spec, options.device),
        coarse=RendererData(Packed(data), spec, side // 2),
    )
    save_run(
        run,
        model,
        renderer_shape(model, {"latent": autoencoder.latent, "width": autoencoder.width}),
    )


def train_intrinsics(
    data: Path,
    held_out: Path,
    run: Path,
    options: TrainingOptions,
    *,
    side: int,
    start: Path | None = None,
) -> None:
    """Train the estimator of albedo, normals and depth; arguments as `train_vae`."""
    samples = _held_out(IntrinsicsData(Packed(held_out)), options.samples)
    network = IntrinsicsNet()
    if start is not None:
        _load(network, start / MODEL_FILE)
    model = train(
        network,
        intrinsics_loss,
        IntrinsicsData(Packed(data), side),
        run,
        options,
        intrinsics_sheet(samples, options.device),
    )
    save_run(run, model, {})


def load_vae(run: Path) -> tuple[VAE, BackboneSpec]:
    """The trained VAE of a run, and the embedded backbone's spec with its latent space."""
    shape = _read_shape(run)
    return _vae(shape, run / MODEL_FILE), spec_of(shape)


def load_renderer(run: Path) -> tuple[Renderer, BackboneSpec]:
    """The trained renderer of a run with its VAE, and the spec of the backbone they make."""
    shape = _read_shape(run)
    spec = spec_of(shape["vae"])
    model = new_renderer(_vae(shape["vae"], None), spec, shape["width"], shape["depth"])
    _load(model, run / MODEL_FILE)
    return model.eval(), spec


def new_renderer(vae: VAE, spec: BackboneSpec, width: int, depth: int) -> Renderer:
    """Untrained condition encoder and denoiser over a VAE."""
    condition = ConditionEncoder(vae, spec.channels)
    alpha_bar = torch.from_numpy(alphas_cumprod(spec.schedule))
    denoiser = Denoiser(spec.latent.channels, condition.channels, width, depth, alpha_bar)
    return Renderer(vae, condition, denoiser)


def renderer_shape(renderer: Renderer, vae: dict[str, Any]) -> dict[str, Any]:
    """What a renderer is built from again: its own sizes, and the shape of its VAE."""
    denoiser = renderer.denoiser
    return {"width": denoiser.width, "depth": len(denoiser.deep), "vae": vae}


def spec_of(shape: dict[str, Any]) -> BackboneSpec:
    """The embedded backbone's spec, with the latent channels of a VAE's ``shape``."""
    mini = BACKBONES["mini"]
    return replace(mini, latent=replace(mini.latent, channels=shape["latent"]))


def starting(
    renderer: Renderer, spec: BackboneSpec, brightness: float, deviation: float
) -> BackboneSpec:
    """The spec with initial latents of a trained renderer's own.

    Parameters
    ----------
    renderer : Renderer
    spec : BackboneSpec
    brightness : float
        What their mean adds to an encoded picture in [0, 1].
    deviation : float
        See `LatentSpec`.
    """
    ends = torch.tensor([1.0, -1.0])[:, None, None, None].expand(2, 3, PATCH, PATCH)
    with torch.no_grad():
        white, black = renderer.vae.analysis(ends).flatten(1).double()
    mean = tuple(round(float(each), 4) for each in brightness * (white - black))
    latent = replace(spec.latent, start_mean=mean if brightness else (), start_deviation=deviation)
    return replace(spec, latent=latent)


def _vae(shape: dict[str, Any], weights: Path | None) -> VAE:
    vae = VAE(shape["latent"], shape["width"])
    if weights is not None:
        _load(vae, weights)
    return vae.eval()


def _held_out(draw: Any, count: int) -> list[dict[str, Any]]:
    """The same few samples for every sheet of a run."""
    return [draw(np.random.default_rng([7, i])) for i in range(count)]


def _patches(draw: PictureData, count: int = 192) -> torch.Tensor:
    """Patches of training pictures, (N, 3 · 8 · 8)."""
    images = [draw(np.random.default_rng([8, i]))["image"] for i in range(count)]
    columns = functional.unfold(torch.from_numpy(np.stack(images)), PATCH, stride=PATCH)
    return columns.transpose(1, 2).flatten(0, 1).double()


def save_run(run: Path, model: nn.Module, shape: dict[str, Any], *, trained: bool = True) -> None:
    """Write a run's weights; in their metadata the network's shape and whether it was trained."""
    run.mkdir(parents=True, exist_ok=True)
    partial = run / f"{MODEL_FILE}.partial"
    # A renderer holds the VAE's encoder twice; safetensors stores no aliases.
    weights = {name: value.cpu().clone() for name, value in model.state_dict().items()}
    metadata = {"shape": json.dumps(shape), "trained": json.dumps(trained)}
    save_file(weights, partial, metadata=metadata)
    partial.replace(run / MODEL_FILE)


def _read_shape(run: Path) -> dict[str, Any]:
    shape: dict[str, Any] = json.loads(_metadata(run)["shape"])
    return shape


def _is_trained(run: Path) -> bool:
    """Whether a run's weights were trained; those of runs that do not say are taken to be."""
    return bool(json.loads(_metadata(run).get("trained", "true")))


def _metadata(run: Path) -> dict[str, str]:
    path = run / MODEL_FILE
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: expected a finished training; run its 'spotlight-train' command to the end"
        )
    with safe_open(path, framework="pt") as file:
        metadata: dict[str, str] = file.metadata()
    return metadata


def _load(model: nn.Module, path: Path) -> None:
    model.load_state_dict(_weights(path))


def _weights(path: Path) -> dict[str, torch.Tensor]:
    with safe_open(path, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def _grown(model: nn.Module, path: Path) -> None:
    """Start from a run with fewer blocks: those that are new change nothing at first."""
    weights = _weights(path)
    for name in ("denoiser.light.2.weight", "denoiser.light.2.bias"):
        whole = model.state_dict()[name].clone()
        whole[: len(weights[name])] = weights[name]
        weights[name] = whole
    missing, unknown = model.load_state_dict(weights, strict=False)
    strange = [*unknown, *(name for name in missing if not name.startswith(NEW_PARTS))]
    if strange:
        raise ValueError(f"{path}: expected a renderer of the same width, found others: {strange}")


def take_decoder(renderer: Renderer, vae: Path) -> None:
    """Give a renderer the decoder of a VAE that was trained further on the same latents.

    Raises
    ------
    ValueError
        If the VAE's decoder was not trained, or its latents are others.
    """
    trained, _ = load_vae(vae)
    if not _is_trained(vae):
        raise ValueError(
            f"{vae}: expected a trained decoder, found one whose training took no step or did not "
            "end; run its 'spotlight-train vae' command to the end, or another with --start at it"
        )
    if not torch.equal(trained.analysis.weight, renderer.vae.analysis.weight):
        raise ValueError(
            f"{vae}: its latents are not those the renderer was trained on; "
            "train the decoder with --start at the VAE run that the renderer was given"
        )
    renderer.vae.load_state_dict(trained.state_dict())


def load_estimator(run: Path) -> IntrinsicsNet:
    """The trained estimator of a run."""
    _read_shape(run)  # for its error about a run that is not finished
    network = IntrinsicsNet()
    _load(network, run / MODEL_FILE)
    return network.eval()
