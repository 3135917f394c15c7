"""The published forward passes: what an exported graph is held against.

Nothing here shares code with `spotlight_export.networks`: diffusers' modules are called as its
pipelines call them, with the prompt's embedding and ControlNet's residuals, in float32.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy.typing as npt
import torch

from spotlight_export.checkpoint import Checkpoint

__all__ = ["DenoiserReference", "VaeReference"]

Arrays = dict[str, npt.NDArray[Any]]


class VaeReference:
    """diffusers' ``AutoencoderKL``."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        self._vae = checkpoint.load("vae")

    @torch.no_grad()
    def vae_encoder(self, image: npt.NDArray[Any]) -> Arrays:
        """Posterior of an image."""
        posterior = self._vae.encode(torch.from_numpy(image)).latent_dist
        return {"latent_mean": posterior.mean.numpy(), "latent_std": posterior.std.numpy()}

    @torch.no_grad()
    def vae_decoder(self, latents: npt.NDArray[Any]) -> Arrays:
        """Image of latents."""
        return {"image": self._vae.decode(torch.from_numpy(latents)).sample.numpy()}


class DenoiserReference:
    """diffusers' ``ControlNetModel`` and ``UNet2DConditionModel`` with the empty prompt."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        self._prompt = checkpoint.prompt()
        self._controlnet = checkpoint.load("controlnet")
        self._unet = checkpoint.load("unet")

    @torch.no_grad()
    def condition_encoder(self, conditioning: npt.NDArray[Any]) -> Arrays:
        """ControlNet's embedding of the conditioning maps."""
        embedding = self._controlnet.controlnet_cond_embedding
        return {"condition": embedding(torch.from_numpy(conditioning)).numpy()}

    @torch.no_grad()
    def controlnet(
        self, latents: npt.NDArray[Any], timestep: npt.NDArray[Any], condition: npt.NDArray[Any]
    ) -> Arrays:
        """ControlNet's residuals; ``condition`` here are the maps themselves."""
        down, middle = self._controlnet(
            torch.from_numpy(latents),
            torch.from_numpy(timestep)[0],
            encoder_hidden_states=self._prompt.expand(len(latents), -1, -1),
            controlnet_cond=torch.from_numpy(condition),
            return_dict=False,
        )
        return {f"residual_{i}": tensor.numpy() for i, tensor in enumerate([*down, middle])}

    @torch.no_grad()
    def unet(
        self, latents: npt.NDArray[Any], timestep: npt.NDArray[Any], **residuals: npt.NDArray[Any]
    ) -> Arrays:
        """Prediction from given residuals."""
        tensors = [torch.from_numpy(residuals[f"residual_{i}"]) for i in range(len(residuals))]
        prediction = self._unet(
            torch.from_numpy(latents),
            torch.from_numpy(timestep)[0],
            encoder_hidden_states=self._prompt.expand(len(latents), -1, -1),
            down_block_additional_residuals=tuple(tensors[:-1]),
            mid_block_additional_residual=tensors[-1],
            return_dict=False,
        )[0]
        return {"prediction": prediction.numpy()}

    def denoiser(
        self, latents: npt.NDArray[Any], timestep: npt.NDArray[Any], condition: npt.NDArray[Any]
    ) -> Arrays:
        """Prediction; ``condition`` here are the maps themselves."""
        residuals: Arrays = self.controlnet(latents, timestep, condition)
        prediction: Arrays = self.unet(latents, timestep, **residuals)
        return prediction

    def networks(self) -> Mapping[str, Any]:
        """What the runtime's predictor calls."""
        return {"denoiser": self.denoiser}
