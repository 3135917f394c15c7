"""What to trace for a backbone: one job a graph, networks loaded only while their job runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import torch
from torch import nn

from spotlight_export.architecture import check_denoiser_config, check_vae_config
from spotlight_export.attention import fold_prompt
from spotlight_export.checkpoint import Checkpoint
from spotlight_export.errors import UnsupportedArchitectureError
from spotlight_export.networks import (
    ConditionEmbedding,
    ControlNetResiduals,
    FusedDenoiser,
    UNetWithResiduals,
    VaeDecoder,
    VaeEncoder,
    residual_channels,
)
from spotlight_spec import BackboneSpec, GraphContract, GraphLayout, graph_contracts

__all__ = ["GraphJob", "graph_jobs"]

TRACE_BATCH: Final = 2
TRACE_LATENT: Final = (10, 14)
"""Latent size to trace at: not square and nowhere one pixel small, however often it is halved."""


@dataclass(frozen=True)
class GraphJob:
    """One graph to trace: its contract, the network and inputs to trace it with."""

    contract: GraphContract
    network: nn.Module
    example: tuple[torch.Tensor, ...]


def graph_jobs(
    checkpoint: Checkpoint, spec: BackboneSpec, layout: GraphLayout
) -> Iterator[GraphJob]:
    """Yield the jobs of a backbone, each with networks of its own.

    A caller that lets go of a job before it asks for the next holds one job's networks at a time.
    """
    if spec.conditioning_layout not in JOBS:
        raise UnsupportedArchitectureError(
            f"backbone {spec.name!r} takes its conditioning as {spec.conditioning_layout!r}; this "
            f"exporter builds {', '.join(JOBS)}"
        )
    yield from JOBS[spec.conditioning_layout](checkpoint, spec, layout)


def _controlnet_jobs(
    checkpoint: Checkpoint, spec: BackboneSpec, layout: GraphLayout
) -> Iterator[GraphJob]:
    checkpoint.check_conditioning(spec)
    check_vae_config(checkpoint.config("vae"))
    for part in ("unet", "controlnet"):
        check_denoiser_config(part, checkpoint.config(part))
    prompt = checkpoint.prompt()
    controlnet = checkpoint.load("controlnet")
    contracts = {
        contract.name: contract
        for contract in graph_contracts(
            spec,
            condition_channels=controlnet.conv_in.out_channels,
            residual_channels=residual_channels(controlnet) if layout == "split" else (),
        )
    }
    height, width = TRACE_LATENT
    latents = torch.randn(TRACE_BATCH, spec.latent.channels, height, width)
    pixels = (height * spec.latent.downscale, width * spec.latent.downscale)
    train_timesteps = spec.schedule.num_train_timesteps
    timestep = torch.tensor([train_timesteps // 2])

    vae = checkpoint.load("vae")
    image = torch.rand(TRACE_BATCH, 3, *pixels)
    yield GraphJob(contracts["vae_encoder"], VaeEncoder(vae), (image,))
    yield GraphJob(contracts["vae_decoder"], VaeDecoder(vae), (latents,))
    del vae, image

    maps = torch.rand(TRACE_BATCH, spec.conditioning_channels, *pixels)
    embedding = ConditionEmbedding(controlnet)
    yield GraphJob(contracts["condition_encoder"], embedding, (maps,))
    with torch.no_grad():
        noisy = (latents, timestep, embedding(maps))
    fold_prompt(controlnet, prompt)

    if layout == "split":
        residuals_of = ControlNetResiduals(controlnet, train_timesteps)
        yield GraphJob(contracts["controlnet"], residuals_of, noisy)
        with torch.no_grad():
            residuals = residuals_of(*noisy)
        del controlnet, embedding, residuals_of
        unet = checkpoint.load("unet")
        fold_prompt(unet, prompt)
        example = (latents, timestep, *residuals)
        yield GraphJob(contracts["unet"], UNetWithResiduals(unet, train_timesteps), example)
    else:
        unet = checkpoint.load("unet")
        fold_prompt(unet, prompt)
        yield GraphJob(
            contracts["denoiser"], FusedDenoiser(controlnet, unet, train_timesteps), noisy
        )


JOBS: Final[dict[str, Callable[[Checkpoint, BackboneSpec, GraphLayout], Iterator[GraphJob]]]] = {
    "controlnet": _controlnet_jobs
}
"""How to build the graphs of each conditioning layout."""
