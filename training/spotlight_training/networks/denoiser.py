"""The renderer: what the picture is, and how much of the noisy latents that leaves open."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from spotlight_training.networks.blocks import Attention, ResBlock, norm
from spotlight_training.networks.condition import LIGHTS, SEEN_BY
from spotlight_training.networks.finder import Found, LightFinder

__all__ = ["Denoiser"]

KNOWN_VARIANCE: Final = 0.01
"""s² of the latents where the shading is known: what the known picture leaves open."""

HIDDEN_VARIANCE: Final = 0.05
"""The same where it is hidden, to begin with. Samples scatter by as much as the network does not
yet see coming, so a short training wants it small: 0.3 left every latent its own colour."""

TEMPERATURE: Final = 0.3
"""Of a trained renderer: by how much s² is less than what was learned. What the network does not
know of a picture it learns to leave to chance, latent by latent; but a latent's own chance is a
blotch, so trained it paints nearly what it expects."""

WIDER: Final = 3
"""Channels of the deep part, in those of the part at latent size."""

EMBEDDING: Final = 128

COLOURS: Final = 3

LAMP: Final = 0.2
"""Brightness of the lamp that a renderer begins with."""

FOUND_AFTER: Final = 3
"""Share of the deep part's blocks, as a divisor, that look at a place before light is sought."""


class Denoiser(nn.Module):
    """Network over (noisy latents, condition), predicting v.

    The network says what the picture is, ``m = p + r + Σ cₖ·lₖ``: the known picture p, and where
    shading is hidden so much of each of `LIGHTS`, and a rest (edges of shadows, gloss). How much of
    the noisy latents' difference from that is the picture's is not left to learn: were the picture
    m + s·n, the best prediction would be ``x₀ = m + αs²/(α²s²+σ²)·(z − αm)``, which is
    ``v = −σm + ασ(1−s²)/(α²s²+σ²)·(z − αm)``. s² is near 0 where shading is known, and a learned
    number for each channel where it is hidden; once trained, `TEMPERATURE` of it.

    Where light comes from is told by shadows far from what it lights, so the deep part is a
    transformer at half of the latents' size (Peebles & Xie 2023): each place of an object can ask
    every dark place of the floor where it lies. After a third of it `LightFinder` says where the
    light comes from, and the c are a lamp from there, as bright and as coloured as the network
    makes it at each place, and what smooth light it adds; what is at latent size paints the rest.
    The network sees the noisy latents blurred: light and shadow are wider than the blur, and what
    one latent alone could tell is noise, which came out as mottled objects when it was seen.

    Parameters
    ----------
    latent, condition : int
        Channels of latents and condition.
    width : int
        Channels at latent size; the deep part has `WIDER` times as many.
    depth : int
        Blocks of the deep part.
    alphas_cumprod : Tensor, shape (T,)
        ᾱ of every train timestep.
    """

    def __init__(
        self, latent: int, condition: int, width: int, depth: int, alphas_cumprod: Tensor
    ) -> None:
        super().__init__()
        self.register_buffer("alphas_cumprod", alphas_cumprod.float(), persistent=False)
        self.register_buffer("sinusoids", _sinusoids(len(alphas_cumprod), width), persistent=False)
        self.log_variance = nn.Parameter(torch.full((latent,), math.log(HIDDEN_VARIANCE)))
        self.latent, self.width = latent, width
        self.shown = condition - LIGHTS * latent - SEEN_BY
        wide = WIDER * width
        self.embed = nn.Sequential(
            nn.Linear(width, EMBEDDING), nn.SiLU(), nn.Linear(EMBEDDING, EMBEDDING), nn.SiLU()
        )
        self.enter = nn.Conv2d(latent + self.shown, width, 3, padding=1)
        self.first = ResBlock(width, width, EMBEDDING)
        self.down = nn.Conv2d(width, wide, 3, stride=2, padding=1)
        self.deep = nn.ModuleList(_Block(wide, EMBEDDING) for _ in range(depth))
        self.finder = LightFinder(wide, EMBEDDING)
        self.light = nn.Sequential(norm(wide), nn.SiLU(), nn.Conv2d(wide, LIGHTS + COLOURS, 1))
        self.up = nn.Conv2d(wide, width, 3, padding=1)
        self.last = ResBlock(2 * width, width, EMBEDDING)
        self.leave = nn.Sequential(norm(width), nn.SiLU(), nn.Conv2d(width, latent, 3, padding=1))
        for final in (self.light[-1], self.leave[-1]):
            nn.init.zeros_(final.weight)
            nn.init.zeros_(final.bias)
        nn.init.constant_(self.light[-1].bias[LIGHTS:], LAMP)

    @property
    def deep_channels(self) -> int:
        """Channels of what comes up from below latent size: features and light."""
        return self.width + LIGHTS

    def forward(self, latents: Tensor, timestep: Tensor, condition: Tensor) -> Tensor:
        """Prediction v, shape of ``latents``; ``timestep`` is int64 (1,) or (B,)."""
        return self.whole(latents, timestep, condition)[0]

    def whole(self, latents: Tensor, timestep: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Prediction, and the deep features (B, `deep_channels`, h, w) that `shallow` takes."""
        prediction, deep, _ = self.explained(latents, timestep, condition)
        return prediction, deep

    def explained(
        self, latents: Tensor, timestep: Tensor, condition: Tensor
    ) -> tuple[Tensor, Tensor, Found]:
        """What `whole` gives, and the light it is made by."""
        embedding, x = self._enter(latents, timestep, condition)
        deep, found = self._below(embedding, x, condition)
        return self._leave(latents, timestep, condition, deep, embedding, x), deep, found

    def shallow(self, latents: Tensor, timestep: Tensor, condition: Tensor, deep: Tensor) -> Tensor:
        """Prediction from another step's deep features: no more than runs at latent size."""
        embedding, x = self._enter(latents, timestep, condition)
        return self._leave(latents, timestep, condition, deep, embedding, x)

    def _enter(self, latents: Tensor, timestep: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        embedding = self.embed(functional.embedding(timestep, self.sinusoids).to(latents.dtype))
        x = self.enter(torch.cat([_blurred(latents), condition[:, : self.shown]], dim=1))
        return embedding, self.first(x, embedding)

    def _below(self, embedding: Tensor, shown: Tensor, condition: Tensor) -> tuple[Tensor, Found]:
        x = self.down(shown)
        first = len(self.deep) // FOUND_AFTER
        for block in self.deep[:first]:
            x = block(x, embedding)
        told, direct, found = self.finder(x, embedding, condition[:, -SEEN_BY:, ::2, ::2])
        x = x + told
        for block in self.deep[first:]:
            x = block(x, embedding)
        light, lamp = self.light(x).float().split([LIGHTS, COLOURS], dim=1)
        light = light + (direct[:, :, None] * lamp[:, None]).flatten(1, 2)
        light = functional.interpolate(light, scale_factor=2.0, mode="bilinear")
        features = functional.interpolate(self.up(x), scale_factor=2.0)
        deep = torch.cat([features, light.to(x.dtype)], dim=1)
        return deep[..., : shown.shape[-2], : shown.shape[-1]], found

    def _leave(
        self,
        latents: Tensor,
        timestep: Tensor,
        condition: Tensor,
        deep: Tensor,
        embedding: Tensor,
        shown: Tensor,
    ) -> Tensor:
        features, amounts = deep.split([self.width, LIGHTS], dim=1)
        x = self.last(torch.cat([features, shown], dim=1), embedding)
        rest, amounts = self.leave(x).float(), amounts.float()
        known = condition[:, : self.latent].float()
        hidden = condition[:, self.latent, None].float()
        lights = condition[:, self.shown : -SEEN_BY].float().unflatten(1, (LIGHTS, self.latent))
        mean = known + rest + (amounts[:, :, None] * lights).sum(dim=1)
        variance = KNOWN_VARIANCE + hidden * self.log_variance.exp()[None, :, None, None]
        variance = variance if self.training else TEMPERATURE * variance
        level = self.alphas_cumprod[timestep][:, None, None, None]
        alpha, sigma = level.sqrt(), (1 - level).sqrt()
        share = alpha * sigma * (1 - variance) / (level * variance + 1 - level)
        return share * (latents.float() - alpha * mean) - sigma * mean


class _Block(nn.Module):
    """Attention over all places, then two layers a place with a look at its neighbours between."""

    def __init__(self, channels: int, embedding: int) -> None:
        super().__init__()
        self.attention = Attention(channels)
        self.norm = norm(channels)
        self.modulate = nn.Linear(embedding, 2 * channels)
        self.grow = nn.Conv2d(channels, 2 * channels, 1)
        self.mix = nn.Conv2d(2 * channels, 2 * channels, 3, padding=1, groups=2 * channels)
        self.shrink = nn.Conv2d(2 * channels, channels, 1)
        nn.init.zeros_(self.shrink.weight)
        nn.init.zeros_(self.shrink.bias)
        nn.init.zeros_(self.modulate.weight)
        nn.init.zeros_(self.modulate.bias)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        x = self.attention(x)
        scale, shift = self.modulate(embedding)[:, :, None, None].chunk(2, dim=1)
        h = self.norm(x) * (1 + scale) + shift
        return x + self.shrink(functional.silu(self.mix(self.grow(h))))


def _blurred(latents: Tensor) -> Tensor:
    """Two 3×3 means: noise is left by a quarter."""
    for _ in range(2):
        latents = functional.avg_pool2d(latents, 3, 1, 1, count_include_pad=False)
    return latents


def _sinusoids(timesteps: int, channels: int) -> Tensor:
    """Of every timestep: angles of a thousand radians are not for whoever computes in bfloat16."""
    half = torch.arange(channels // 2, dtype=torch.float32)
    frequencies = torch.exp(half * (-math.log(10_000.0) / (channels // 2)))
    angles = torch.arange(timesteps, dtype=torch.float32)[:, None] * frequencies
    return torch.cat([angles.sin(), angles.cos()], dim=-1)
