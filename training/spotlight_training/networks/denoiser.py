"""The renderer: a U-Net over noisy latents and condition, predicting v."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn

from spotlight_training.networks.blocks import Attention, ResBlock, double, norm
from spotlight_training.networks.condition import LIGHTS

__all__ = ["Denoiser"]

KNOWN_VARIANCE: Final = 0.01
"""s² of the latents where the shading is known: what the known picture leaves open."""

HIDDEN_VARIANCE: Final = 0.05
"""The same where it is hidden, to begin with. Samples scatter by as much as the network does not
yet see coming, so a short training wants it small: 0.3 left every latent its own colour."""


class Denoiser(nn.Module):
    """U-Net over (noisy latents, condition), predicting v.

    The U-Net says what the picture is, ``m = p + r + Σ cₖ·lₖ``: the known picture p, and where
    shading is hidden so much of each of `LIGHTS`, and a rest (edges of shadows, gloss). How much of
    the noisy latents' difference from that is the picture's is not left to learn: were the picture
    m + s·n, the best prediction would be ``x₀ = m + αs²/(α²s²+σ²)·(z − αm)``, which is
    ``v = −σm + ασ(1−s²)/(α²s²+σ²)·(z − αm)``. s² is near 0 where shading is known, and a learned
    number for each channel where it is hidden.

    Parameters
    ----------
    latent, condition : int
        Channels of latents and condition.
    widths : tuple of int
        Channels of each level.
    alphas_cumprod : Tensor, shape (T,)
        ᾱ of every train timestep.
    blocks : int
        Residual blocks a level, down and up.
    """

    def __init__(
        self,
        latent: int,
        condition: int,
        widths: tuple[int, ...],
        alphas_cumprod: Tensor,
        blocks: int = 2,
    ) -> None:
        super().__init__()
        self.register_buffer("alphas_cumprod", alphas_cumprod.float(), persistent=False)
        self.log_variance = nn.Parameter(torch.full((latent,), math.log(HIDDEN_VARIANCE)))
        self.latent, self.widths, self.blocks = latent, widths, blocks
        embedding = 4 * widths[0]
        self.embed = nn.Sequential(
            nn.Linear(widths[0], embedding), nn.SiLU(), nn.Linear(embedding, embedding), nn.SiLU()
        )
        self.shown = condition - LIGHTS * latent
        self.enter = nn.Conv2d(latent + self.shown, widths[0], 3, padding=1)
        self.down, self.up = nn.ModuleList(), nn.ModuleList()
        channels, skips = widths[0], list[int]()
        for level, width in enumerate(widths):
            for _ in range(blocks):
                self.down.append(_Stage(channels, width, embedding, attend=level > 0))
                channels = width
                skips.append(channels)
            if level < len(widths) - 1:
                self.down.append(nn.Conv2d(channels, channels, 3, stride=2, padding=1))
        self.middle = _Stage(channels, channels, embedding, attend=True)
        for level, width in reversed(list(enumerate(widths))):
            for _ in range(blocks):
                self.up.append(_Stage(channels + skips.pop(), width, embedding, attend=level > 0))
                channels = width
            if level > 0:
                self.up.append(nn.Conv2d(channels, channels, 3, padding=1))
        self.leave = nn.Sequential(
            norm(channels), nn.SiLU(), nn.Conv2d(channels, latent + LIGHTS, 3, padding=1)
        )
        nn.init.zeros_(self.leave[-1].weight)

    @property
    def deep_channels(self) -> int:
        """Channels of what comes up from below latent size."""
        return self.widths[min(1, len(self.widths) - 1)]

    def forward(self, latents: Tensor, timestep: Tensor, condition: Tensor) -> Tensor:
        """Prediction v, shape of ``latents``; ``timestep`` is int64 (1,) or (B,)."""
        return self.whole(latents, timestep, condition)[0]

    def whole(self, latents: Tensor, timestep: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Prediction, and the deep features (B, `deep_channels`, h, w) that `shallow` takes."""
        embedding, skips = self._enter(latents, timestep, condition)
        deep = self._below(embedding, skips)
        return self._leave(latents, timestep, condition, deep, embedding, skips), deep

    def shallow(self, latents: Tensor, timestep: Tensor, condition: Tensor, deep: Tensor) -> Tensor:
        """Prediction from another step's deep features: no more than runs at latent size."""
        embedding, skips = self._enter(latents, timestep, condition)
        return self._leave(latents, timestep, condition, deep, embedding, skips)

    def _enter(
        self, latents: Tensor, timestep: Tensor, condition: Tensor
    ) -> tuple[Tensor, list[Tensor]]:
        embedding = self.embed(_sinusoid(timestep, self.widths[0]).to(latents.dtype))
        x = self.enter(torch.cat([latents, condition[:, : self.shown]], dim=1))
        skips = []
        for stage in list(self.down)[: self.blocks]:
            x = stage(x, embedding)
            skips.append(x)
        return embedding, skips

    def _below(self, embedding: Tensor, shown: list[Tensor]) -> Tensor:
        skips = list(shown)
        x = skips[-1]
        for stage in list(self.down)[self.blocks :]:
            if isinstance(stage, _Stage):
                x = stage(x, embedding)
                skips.append(x)
            else:
                x = stage(x)
        x = self.middle(x, embedding)
        for stage in list(self.up)[: -self.blocks]:
            if isinstance(stage, _Stage):
                x = stage(torch.cat([x, skips.pop()], dim=1), embedding)
            else:
                x = stage(double(x, like=skips[-1]))
        return x

    def _leave(
        self,
        latents: Tensor,
        timestep: Tensor,
        condition: Tensor,
        x: Tensor,
        embedding: Tensor,
        skips: list[Tensor],
    ) -> Tensor:
        for stage, skip in zip(list(self.up)[-self.blocks :], reversed(skips)):
            x = stage(torch.cat([x, skip], dim=1), embedding)
        rest, amounts = self.leave(x).float().split([self.latent, LIGHTS], dim=1)
        known = condition[:, : self.latent].float()
        hidden = condition[:, self.latent, None].float()
        lights = condition[:, self.shown :].float().unflatten(1, (LIGHTS, self.latent))
        mean = known + rest + (amounts[:, :, None] * lights).sum(dim=1)
        variance = KNOWN_VARIANCE + hidden * self.log_variance.exp()[None, :, None, None]
        level = self.alphas_cumprod[timestep][:, None, None, None]
        alpha, sigma = level.sqrt(), (1 - level).sqrt()
        share = alpha * sigma * (1 - variance) / (level * variance + 1 - level)
        return share * (latents.float() - alpha * mean) - sigma * mean


class _Stage(nn.Module):
    def __init__(self, inputs: int, outputs: int, embedding: int, *, attend: bool) -> None:
        super().__init__()
        self.block = ResBlock(inputs, outputs, embedding)
        self.attention = Attention(outputs) if attend else nn.Identity()

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        return self.attention(self.block(x, embedding))


def _sinusoid(timestep: Tensor, channels: int) -> Tensor:
    half = torch.arange(channels // 2, device=timestep.device, dtype=torch.float32)
    frequencies = torch.exp(half * (-math.log(10_000.0) / (channels // 2)))
    angles = timestep.float()[:, None] * frequencies
    return torch.cat([angles.sin(), angles.cos()], dim=-1)
