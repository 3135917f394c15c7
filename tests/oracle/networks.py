"""A published checkpoint run the ordinary way: diffusers' own modules, in any precision."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from diffusers import AutoencoderKL, ControlNetModel, UNet2DConditionModel
from torch import Tensor
from transformers import CLIPTextModel

EMPTY_PROMPT = [49406, 49407] + [0] * 75
"""Stable Diffusion 2's tokens for "": start, end, and padding, whose token is "!"."""


@dataclass(frozen=True)
class Backbone:
    """UNet, ControlNet and VAE of one checkpoint, and the embedding of the empty prompt."""

    unet: UNet2DConditionModel
    controlnet: ControlNetModel
    vae: AutoencoderKL
    prompt: Tensor

    @classmethod
    def load(cls, base: Path, controlnet: Path, dtype: torch.dtype) -> Backbone:
        """The checkpoint under `base`, and the ControlNet whose folder holds `controlnet/`."""
        text = CLIPTextModel.from_pretrained(base / "text_encoder", dtype=dtype).eval()
        with torch.no_grad():
            prompt = text(torch.tensor([EMPTY_PROMPT])).last_hidden_state
        unet, control, vae = (
            kind.from_pretrained(folder / name, torch_dtype=dtype).eval().requires_grad_(False)
            for kind, folder, name in (
                (UNet2DConditionModel, base, "unet"),
                (ControlNetModel, controlnet, "controlnet"),
                (AutoencoderKL, base, "vae"),
            )
        )
        return cls(unet, control, vae, prompt.to(dtype))

    @property
    def scale(self) -> float:
        """s, the VAE's scaling factor."""
        return self.vae.config.scaling_factor

    @torch.no_grad()
    def evaluate(self, z_t: Tensor, t: int, conditioning: Tensor) -> Tensor:
        """The v-predictions of a batch: (n, 4, h, w) latents, (n, C, H, W) conditioning."""
        prompt = self.prompt.expand(len(z_t), -1, -1)
        down, middle = self.controlnet(
            z_t,
            t,
            encoder_hidden_states=prompt,
            controlnet_cond=conditioning,
            return_dict=False,
        )
        return self.unet(
            z_t,
            t,
            encoder_hidden_states=prompt,
            down_block_additional_residuals=down,
            mid_block_additional_residual=middle,
            return_dict=False,
        )[0]

    def predict(self, z_t: Tensor, t: int, conditioning: Tensor) -> Tensor:
        """The v-prediction of one branch: (4, h, w) latents, (C, H, W) conditioning."""
        return self.evaluate(z_t[None], t, conditioning[None])[0]

    @torch.no_grad()
    def posterior(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the VAE's posterior of a (3, H, W) image in [−1, 1]."""
        posterior = self.vae.encode(image[None]).latent_dist
        return posterior.mean[0], posterior.std[0]

    @torch.no_grad()
    def decoded(self, z: Tensor) -> Tensor:
        """D(z/s), an image in [−1, 1]."""
        return self.vae.decode(z[None] / self.scale, return_dict=False)[0][0]
