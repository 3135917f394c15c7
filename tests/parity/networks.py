"""A checkpoint's torch modules as the networks a `Relighter` takes: plain callables on arrays."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import numpy as np
import torch
from oracle.networks import Backbone

__all__ = ["as_networks"]

Arrays = dict[str, np.ndarray]


def as_networks(backbone: Backbone) -> dict[str, Callable[..., Arrays]]:
    """The four graphs of the contract, cut from the modules in the precision they have.

    The condition encoder is ControlNet's embedding of the conditioning; the denoiser is ControlNet
    without it, and the UNet, on the whole batch at once.
    """
    embedding = backbone.controlnet.controlnet_cond_embedding
    controlnet = deepcopy(backbone.controlnet)
    controlnet.controlnet_cond_embedding = torch.nn.Identity()

    def denoiser(latents: np.ndarray, timestep: np.ndarray, condition: np.ndarray) -> Arrays:
        z, t = torch.from_numpy(latents), torch.from_numpy(timestep)
        prompt = backbone.prompt.expand(len(z), -1, -1)
        down, middle = controlnet(z, t, prompt, torch.from_numpy(condition), return_dict=False)
        v = backbone.unet(
            z,
            t,
            prompt,
            down_block_additional_residuals=down,
            mid_block_additional_residual=middle,
            return_dict=False,
        )[0]
        return {"prediction": v.numpy()}

    def vae_encoder(image: np.ndarray) -> Arrays:
        posterior = backbone.vae.encode(torch.from_numpy(image)).latent_dist
        return {"latent_mean": posterior.mean.numpy(), "latent_std": posterior.std.numpy()}

    def vae_decoder(latents: np.ndarray) -> Arrays:
        return {"image": backbone.vae.decode(torch.from_numpy(latents)).sample.numpy()}

    def condition_encoder(conditioning: np.ndarray) -> Arrays:
        return {"condition": embedding(torch.from_numpy(conditioning)).numpy()}

    graphs = (vae_encoder, condition_encoder, denoiser, vae_decoder)
    return {graph.__name__: torch.no_grad()(graph) for graph in graphs}
