"""The embedded backbone's networks: a small VAE, a latent renderer, and an intrinsics estimator.

Sized for two CPU cores. All of them are convolutional with dynamic height and width (multiples of
8 pixels, odd latent sizes included), so the exported graphs take any picture.

* `VAE`: 8× down, on the principal components of patches.
* `ConditionEncoder` and `Denoiser`: the renderer. Intrinsic maps enter as latents concatenated to
  the noisy latents, as RGB↔X does: the picture as far as it is known through the VAE, so that what
  is copied to the output needs no translation, and all maps through a learned projection.
* `IntrinsicsNet`: a photograph's albedo, normals and depth.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

__all__ = ["VAE", "ConditionEncoder", "Denoiser", "IntrinsicsNet"]


PATCH: Final = 8
"""Pixels per latent."""

GAMMA: Final = 2.2
"""Of the pictures the renderer paints."""

KNOWN_VARIANCE: Final = 0.01
"""s² of the latents where the shading is known: what the known picture leaves open."""

HIDDEN_VARIANCE: Final = 0.05
"""The same where it is hidden, to begin with. Samples scatter by as much as the network does not
yet see coming, so a short training wants it small: 0.3 left every latent its own colour."""

SURROUNDINGS: Final = ((3, 1.0), (7, 1e-2), (15, 1e-4), (31, 1e-6))
"""Squares, in latents, from which light is taken for a hidden place, and their weights: the nearest
known light decides, and further away counts where nearer by all is hidden."""

LIGHTS: Final = 12
"""Ways to light a hidden place: by red, green, blue, each evenly or along an axis of the normals.
Irradiance is nearly linear in the normal (the first spherical harmonics; Ramamoorthi & Hanrahan
2001), so twelve smooth numbers light all the detail that albedo and normals have."""

EVERYWHERE: Final = 1e-8
"""Weight of all the picture's light; smaller than any square's."""

GREY: Final = 0.1
"""Albedo that grey light is believed with: what is nearly black says little of the light's colour.
Without it dark wooden floors made objects teal."""

NOTHING_KNOWN: Final = (1e-10, 0.5)
"""Weight and amount of the light that is assumed where no light at all is known."""

POSTERIOR_DEVIATION: Final = 0.1
"""Of each latent, in its own standard deviations: what the decoder learns to tolerate."""


def _norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(math.gcd(32, channels), channels)


class ResBlock(nn.Module):
    """Two 3×3 convolutions with a skip; a time embedding may scale and shift the second norm."""

    def __init__(self, inputs: int, outputs: int, embedding: int | None = None) -> None:
        super().__init__()
        self.norm1, self.conv1 = _norm(inputs), nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm2, self.conv2 = _norm(outputs), nn.Conv2d(outputs, outputs, 3, padding=1)
        self.modulate = None if embedding is None else nn.Linear(embedding, 2 * outputs)
        self.skip = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)
        nn.init.zeros_(self.conv2.weight)

    def forward(self, x: Tensor, embedding: Tensor | None = None) -> Tensor:
        h = self.conv1(functional.silu(self.norm1(x)))
        h = self.norm2(h)
        if self.modulate is not None and embedding is not None:
            scale, shift = self.modulate(embedding)[:, :, None, None].chunk(2, dim=1)
            h = h * (1 + scale) + shift
        return self.skip(x) + self.conv2(functional.silu(h))


class Attention(nn.Module):
    """Self-attention over all positions."""

    def __init__(self, channels: int, head_channels: int = 64) -> None:
        super().__init__()
        self.heads = channels // head_channels
        self.norm = _norm(channels)
        self.qkv = nn.Conv2d(channels, 3 * channels, 1)
        self.out = nn.Conv2d(channels, channels, 1)
        nn.init.zeros_(self.out.weight)

    def forward(self, x: Tensor) -> Tensor:
        batch, channels, height, width = x.shape
        qkv = self.qkv(self.norm(x)).reshape(batch, 3, self.heads, -1, height * width)
        q, k, v = (t.transpose(-1, -2) for t in qkv.unbind(1))
        h = functional.scaled_dot_product_attention(q, k, v)
        return x + self.out(h.transpose(-1, -2).reshape(batch, channels, height, width))


def _double(x: Tensor, like: Tensor | None = None) -> Tensor:
    """Nearest upsampling by 2, cropped to ``like`` where that is one smaller."""
    x = x.repeat_interleave(2, dim=-2).repeat_interleave(2, dim=-1)
    return x if like is None else x[..., : like.shape[-2], : like.shape[-1]]


class VAE(nn.Module):
    """Autoencoder with a diagonal Gaussian posterior; images in [−1, 1], 8× down.

    The encoder is the principal components of 8×8 patches, standardised: the best linear one, known
    at once. Twenty minutes of training a convolutional encoder on two cores came 3 dB short of it.
    It also costs the renderer's training nothing, and its latents are ready before any decoder.
    The decoder is the components' own synthesis, and a convolutional network that adds what
    neighbouring patches tell.
    """

    def __init__(self, latent: int = 16, width: int = 64) -> None:
        super().__init__()
        self.latent, self.width = latent, width
        wide = 2 * width
        self.analysis = nn.Conv2d(3, latent, PATCH, stride=PATCH).requires_grad_(False)
        self.synthesis = nn.Sequential(
            nn.Conv2d(latent, 3 * PATCH * PATCH, 1), nn.PixelShuffle(PATCH)
        ).requires_grad_(False)
        self.low = nn.Sequential(
            nn.Conv2d(latent, wide, 3, padding=1), *(ResBlock(wide, wide) for _ in range(2))
        )
        self.middle = nn.Sequential(
            nn.Conv2d(wide, width, 3, padding=1), *(ResBlock(width, width) for _ in range(2))
        )
        self.high = nn.Sequential(
            _norm(width),
            nn.SiLU(),
            nn.Conv2d(width, 4 * 24, 3, padding=1),
            nn.PixelShuffle(2),
            ResBlock(24, 24),
            nn.Conv2d(24, 12, 3, padding=1),
            nn.PixelShuffle(2),
        )
        nn.init.zeros_(self.high[-2].weight)
        nn.init.zeros_(self.high[-2].bias)

    def encode(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and log variance, (B, latent, H/8, W/8)."""
        mean = self.analysis(image)
        return mean, torch.full_like(mean, 2 * math.log(POSTERIOR_DEVIATION))

    def decode(self, z: Tensor) -> Tensor:
        """Image (B, 3, H, W), nominally in [−1, 1]."""
        return self.synthesis(z) + self.high(self.middle(_double(self.low(z))))

    @torch.no_grad()
    def fit_patches(self, patches: Tensor) -> Tensor:
        """Set analysis and synthesis to the principal components of patches.

        Parameters
        ----------
        patches : Tensor of float64, shape (N, 3 · 8 · 8)
            Channel first, as a convolution's weight has them.

        Returns
        -------
        Tensor, shape (latent,)
            Each component's standard deviation in the patches, largest first.
        """
        mean = patches.mean(dim=0)
        variances, vectors = torch.linalg.eigh(torch.cov((patches - mean).T))
        components = vectors.flip(1)[:, : self.latent]
        deviations = variances.flip(0)[: self.latent].sqrt()
        scaled = (components / deviations).T
        self.analysis.weight.copy_(scaled.reshape(self.analysis.weight.shape))
        self.analysis.bias.copy_(-scaled @ mean)
        self.synthesis[0].weight.copy_((components * deviations)[..., None, None])
        self.synthesis[0].bias.copy_(mean)
        return deviations.float()


class ConditionEncoder(nn.Module):
    """Conditioning maps → condition at latent size.

    The first ``latent`` channels are the latents of the *known picture*: albedo × shading where
    the shading is known, and where it is hidden the albedo under the light of its surroundings.
    In the one the renderer has nothing left to do, in the other only what light and shadow there
    are besides. That guess alone is closer (18 dB on hidden pixels) than albedo under white light
    (14.7 dB), from which a renderer had come to 19.6 dB after 2,600 steps of 256 pixels. The next
    channel is the share of each latent's pixels that are hidden, and then comes a learned
    projection of all maps, which keeps what the latents lose. Last are the hidden pixels' latents
    as each of `LIGHTS` would change them: what the renderer finds of light, it says in these.

    Parameters
    ----------
    vae : VAE
        Trained and frozen.
    slices : dict of str to slice
        Where each map is in the conditioning array.
    learned : int
        Channels of the projection.
    """

    def __init__(self, vae: VAE, slices: dict[str, slice], learned: int = 64) -> None:
        super().__init__()
        self.analysis, self.latent, self.slices = vae.analysis, vae.latent, slices
        channels = max(part.stop for part in slices.values())
        self.project = nn.Sequential(
            nn.PixelUnshuffle(8),
            nn.Conv2d(64 * channels, 2 * learned, 1),
            nn.SiLU(),
            nn.Conv2d(2 * learned, learned, 3, padding=1),
        )

    @property
    def channels(self) -> int:
        """Channels of the condition."""
        return self.latent + 1 + self.project[-1].out_channels + LIGHTS * self.latent

    def forward(self, conditioning: Tensor) -> Tensor:
        """Condition (B, E, H/8, W/8) of maps (B, K, H, W)."""
        albedo, shading, mask, normal = (
            conditioning[:, self.slices[name]] for name in ("albedo", "shading", "mask", "normal")
        )
        seen = (albedo * shading).clamp(0.0, 1.0)
        lit = albedo * surrounding_light(seen**GAMMA, albedo, (mask > 0).to(albedo.dtype))
        known = torch.where(mask > 0, seen, lit.clamp(0.0, 1.0) ** (1.0 / GAMMA))
        encoded = self.analysis(2 * known - 1)
        relit = 2 * known * (mask < 0).to(known.dtype)
        ways = torch.cat([relit, *(relit * axis for axis in (2 * normal - 1).split(1, dim=1))], 1)
        kernels = self.analysis.weight.transpose(0, 1).reshape(-1, 1, PATCH, PATCH)
        lights = functional.conv2d(
            ways, kernels.repeat(LIGHTS // 3, 1, 1, 1), stride=PATCH, groups=LIGHTS
        )
        # Depth and shading reach 20 and 1,000; the logarithm keeps them in the network's range
        # and leaves the fill value −1 apart from every known value.
        squashed = torch.sign(conditioning) * torch.log1p(conditioning.abs())
        hidden = functional.avg_pool2d((mask < 0).to(encoded.dtype), PATCH)
        return torch.cat([encoded, hidden, self.project(squashed), lights], dim=1)


def surrounding_light(linear: Tensor, albedo: Tensor, known: Tensor) -> Tensor:
    """Light that falls on each pixel, from where it is known around it.

    A normalised convolution (Knutsson & Westin 1993): sums of what is seen over sums of albedo.

    Parameters
    ----------
    linear, albedo : Tensor, shape (B, 3, H, W)
    known : Tensor, shape (B, 1, H, W)
        1 where ``linear`` is to be believed, else 0.

    Returns
    -------
    Tensor, shape (B, 3, H, W)
    """
    weight, light = NOTHING_KNOWN

    def around(x: Tensor, prior: float) -> Tensor:
        x = functional.avg_pool2d(x * known, PATCH)
        total = EVERYWHERE * x.mean(dim=(2, 3), keepdim=True) + prior
        for side, share in SURROUNDINGS:
            total = total + share * functional.avg_pool2d(x, side, 1, side // 2)
        return total

    seen, white = around(linear, weight * light), around(albedo, weight)
    believed = GREY * around(known, 0.0)
    grey = seen.mean(dim=1, keepdim=True) / white.mean(dim=1, keepdim=True)
    coarse = (seen + believed * grey) / (white + believed)
    return functional.interpolate(coarse, scale_factor=PATCH, mode="bilinear")


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
        self.latent, self.widths = latent, widths
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
            _norm(channels), nn.SiLU(), nn.Conv2d(channels, latent + LIGHTS, 3, padding=1)
        )
        nn.init.zeros_(self.leave[-1].weight)

    def forward(self, latents: Tensor, timestep: Tensor, condition: Tensor) -> Tensor:
        """Prediction v, shape of ``latents``; ``timestep`` is int64 (1,) or (B,)."""
        embedding = self.embed(_sinusoid(timestep, self.widths[0]).to(latents.dtype))
        x = self.enter(torch.cat([latents, condition[:, : self.shown]], dim=1))
        skips = []
        for stage in self.down:
            if isinstance(stage, _Stage):
                x = stage(x, embedding)
                skips.append(x)
            else:
                x = stage(x)
        x = self.middle(x, embedding)
        for stage in self.up:
            if isinstance(stage, _Stage):
                x = stage(torch.cat([x, skips.pop()], dim=1), embedding)
            else:
                x = stage(_double(x, like=skips[-1]))
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


class IntrinsicsNet(nn.Module):
    """Photograph in [0, 1] → albedo in [0, 1], unit normals, positive depth (B, 7, H, W).

    The network says how albedo differs from the photograph's own linear colour, in logits: texture
    and hue are there from the first step. (Asked for the albedo itself it was grey after eight
    thousand samples.) Normals start out facing the camera, so that none is the direction of a
    vector of nearly no length, which any rounding turns around.
    """

    def __init__(self, widths: tuple[int, ...] = (64, 128, 192, 256)) -> None:
        super().__init__()
        self.widths = widths
        self.enter = nn.Sequential(nn.PixelUnshuffle(4), nn.Conv2d(48, widths[0], 3, padding=1))
        self.down = nn.ModuleList(
            nn.ModuleList(
                [
                    nn.Sequential(ResBlock(a, a), ResBlock(a, a)),
                    nn.Conv2d(a, b, 3, stride=2, padding=1),
                ]
            )
            for a, b in pairwise(widths)
        )
        deepest = widths[-1]
        self.middle = nn.Sequential(
            ResBlock(deepest, deepest), Attention(deepest), ResBlock(deepest, deepest)
        )
        self.up = nn.ModuleList(
            nn.ModuleList(
                [
                    nn.Conv2d(b, a, 3, padding=1),
                    nn.Sequential(ResBlock(2 * a, a), ResBlock(a, a)),
                ]
            )
            for a, b in reversed(list(pairwise(widths)))
        )
        self.leave = nn.Sequential(
            _norm(widths[0]), nn.SiLU(), nn.Conv2d(widths[0], 16 * 7, 3, padding=1)
        )
        self.fold = nn.PixelShuffle(4)
        with torch.no_grad():
            self.leave[-1].bias[5 * 16 : 6 * 16] += 1.0

    def forward(self, image: Tensor) -> Tensor:
        """Albedo, normal and depth stacked, of an image (B, 3, H, W)."""
        x = self.enter(2 * image - 1)
        skips = []
        for blocks, shrink in self.down:
            x = blocks(x)
            skips.append(x)
            x = shrink(x)
        x = self.middle(x)
        for grow, blocks in self.up:
            skip = skips.pop()
            x = blocks(torch.cat([grow(_double(x, like=skip)), skip], dim=1))
        raw = self.fold(self.leave(x))
        albedo = (raw[:, :3] + torch.logit(image.clamp(0.0, 1.0) ** GAMMA, eps=1e-2)).sigmoid()
        normal = functional.normalize(raw[:, 3:6], dim=1, eps=1e-4)
        return torch.cat([albedo, normal, raw[:, 6:].clamp(-8.0, 8.0).exp()], dim=1)
