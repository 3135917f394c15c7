"""The networks as they are exported: thin forwards over diffusers' own blocks.

Each class takes and returns exactly what its graph contract says. They differ from the published
forward passes only in what a constant prompt, a batch-wide timestep and an already encoded
condition make unnecessary; the arithmetic that remains is the same, and ``verify`` holds it
against the published forward passes themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import nn
from torch.nn.functional import interpolate

__all__ = [
    "ConditionEmbedding",
    "ControlNetResiduals",
    "FusedDenoiser",
    "UNetWithResiduals",
    "VaeDecoder",
    "VaeEncoder",
    "residual_channels",
]

LOG_VARIANCE_RANGE = (-30.0, 20.0)
"""Bounds the latent diffusion VAE puts on its posterior's log variance."""


class VaeEncoder(nn.Module):
    """Image in [-1, 1] → mean and standard deviation of the latent posterior."""

    def __init__(self, vae: nn.Module) -> None:
        super().__init__()
        self.encoder = vae.encoder
        self.quant_conv = vae.quant_conv or nn.Identity()

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Encode."""
        mean, log_variance = self.quant_conv(self.encoder(image)).chunk(2, dim=1)
        return mean, torch.exp(0.5 * log_variance.clamp(*LOG_VARIANCE_RANGE))


class VaeDecoder(nn.Module):
    """Unscaled latents → image."""

    def __init__(self, vae: nn.Module) -> None:
        super().__init__()
        self.post_quant_conv = vae.post_quant_conv or nn.Identity()
        self.decoder = vae.decoder
        _use_plain_upsampling(self.decoder)

    def forward(self, latents: torch.Tensor) -> torch.Tensor:
        """Decode."""
        return self.decoder(self.post_quant_conv(latents))


class ConditionEmbedding(nn.Module):
    """Conditioning maps → ControlNet's embedding of them, which no timestep enters."""

    def __init__(self, controlnet: nn.Module) -> None:
        super().__init__()
        self.embedding = controlnet.controlnet_cond_embedding

    def forward(self, conditioning: torch.Tensor) -> torch.Tensor:
        """Embed."""
        return self.embedding(conditioning)


class ControlNetResiduals(nn.Module):
    """Latents, timestep, condition → what ControlNet adds to the UNet's skips and its middle."""

    def __init__(self, controlnet: nn.Module, train_timesteps: int) -> None:
        super().__init__()
        self.time = _TimeEmbedding(controlnet, train_timesteps)
        self.conv_in = controlnet.conv_in
        self.down_blocks = controlnet.down_blocks
        self.mid_block = controlnet.mid_block
        self.zero_convs = controlnet.controlnet_down_blocks
        self.zero_conv_mid = controlnet.controlnet_mid_block

    def forward(
        self, latents: torch.Tensor, timestep: torch.Tensor, condition: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        """Return the residuals in order, the middle's last."""
        embedding = self.time(timestep)
        x, skips = _descend(self.down_blocks, self.conv_in(latents) + condition, embedding)
        x = self.mid_block(x, embedding)
        residuals = [conv(skip) for conv, skip in zip(self.zero_convs, skips, strict=True)]
        return (*residuals, self.zero_conv_mid(x))


class UNetWithResiduals(nn.Module):
    """Latents, timestep, ControlNet's residuals → prediction."""

    def __init__(self, unet: nn.Module, train_timesteps: int) -> None:
        super().__init__()
        self.time = _TimeEmbedding(unet, train_timesteps)
        self.conv_in = unet.conv_in
        self.down_blocks = unet.down_blocks
        self.mid_block = unet.mid_block
        self.up_blocks = unet.up_blocks
        self.out = nn.Sequential(unet.conv_norm_out, unet.conv_act, unet.conv_out)
        _use_plain_upsampling(self.up_blocks)

    def forward(
        self, latents: torch.Tensor, timestep: torch.Tensor, *residuals: torch.Tensor
    ) -> torch.Tensor:
        """Predict."""
        embedding = self.time(timestep)
        x, skips = _descend(self.down_blocks, self.conv_in(latents), embedding)
        *skip_residuals, mid_residual = residuals
        skips = [skip + added for skip, added in zip(skips, skip_residuals, strict=True)]
        x = self.mid_block(x, embedding) + mid_residual
        return self.out(_ascend(self.up_blocks, x, skips, embedding))


class FusedDenoiser(nn.Module):
    """Latents, timestep, condition → prediction: ControlNet and UNet in one graph."""

    def __init__(self, controlnet: nn.Module, unet: nn.Module, train_timesteps: int) -> None:
        super().__init__()
        self.controlnet = ControlNetResiduals(controlnet, train_timesteps)
        self.unet = UNetWithResiduals(unet, train_timesteps)

    def forward(
        self, latents: torch.Tensor, timestep: torch.Tensor, condition: torch.Tensor
    ) -> torch.Tensor:
        """Predict."""
        return self.unet(latents, timestep, *self.controlnet(latents, timestep, condition))


def residual_channels(controlnet: nn.Module) -> tuple[int, ...]:
    """Channels of ControlNet's residuals in order, the middle's last."""
    convs = [*controlnet.controlnet_down_blocks, controlnet.controlnet_mid_block]
    return tuple(conv.out_channels for conv in convs)


class _TimeEmbedding(nn.Module):
    """Timestep, shared by the batch → embedding of shape (1, channels), broadcast by its users.

    The sines of every train timestep are a table. Their angles go up to a thousand radians, where
    neighbours in bfloat16 lie 4 apart: an engine that computes in it would take sines of chance.
    """

    def __init__(self, network: nn.Module, train_timesteps: int) -> None:
        super().__init__()
        self.sinusoids = nn.Embedding.from_pretrained(
            network.time_proj(torch.arange(train_timesteps))
        )
        self.mlp = network.time_embedding

    def forward(self, timestep: torch.Tensor) -> torch.Tensor:
        return self.mlp(self.sinusoids(timestep))


class _PlainUpsampling(nn.Module):
    """Repeat every pixel 2×2, crop to the size of the skip connection, convolve.

    Nearest interpolation to an odd size 2n − 1 picks source pixel floor(i·n / (2n − 1)), which
    equals floor(i / 2) for all i < 2n − 1: repetition and a crop. Written so, the graph holds a
    resize by the constant factor two and no size that a trace could bake in.
    """

    def __init__(self, conv: nn.Module) -> None:
        super().__init__()
        self.conv = conv

    def forward(
        self, hidden_states: torch.Tensor, output_size: Sequence[int] | None = None
    ) -> torch.Tensor:
        x = interpolate(hidden_states, scale_factor=2.0, mode="nearest")
        if output_size is not None:
            height, width = output_size
            x = x[:, :, :height, :width]
        return self.conv(x)


def _use_plain_upsampling(network: nn.Module) -> None:
    for module in network.modules():
        if getattr(module, "upsamplers", None) is not None:
            module.upsamplers = nn.ModuleList(
                _PlainUpsampling(layer.conv) for layer in module.upsamplers
            )


def _descend(
    blocks: Iterable[nn.Module], x: torch.Tensor, embedding: torch.Tensor
) -> tuple[torch.Tensor, list[torch.Tensor]]:
    skips = [x]
    for block in blocks:
        x, outputs = block(hidden_states=x, temb=embedding)
        skips.extend(outputs)
    return x, skips


def _ascend(
    blocks: nn.ModuleList, x: torch.Tensor, skips: list[torch.Tensor], embedding: torch.Tensor
) -> torch.Tensor:
    for block in blocks:
        count = len(block.resnets)
        taken, skips = skips[-count:], skips[:-count]
        x = block(
            hidden_states=x,
            res_hidden_states_tuple=tuple(taken),
            temb=embedding,
            upsample_size=skips[-1].shape[-2:] if skips else None,
        )
    return x
