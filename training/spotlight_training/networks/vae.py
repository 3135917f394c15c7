"""The autoencoder: principal components of patches, and a learned correction."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from spotlight_training.networks.blocks import PATCH, ResBlock, norm

__all__ = ["VAE"]

POSTERIOR_DEVIATION: Final = 0.1
"""Of each latent, in its own standard deviations: what the decoder learns to tolerate."""


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
            norm(width),
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
        finer = functional.interpolate(self.low(z), scale_factor=2.0)
        return self.synthesis(z) + self.high(self.middle(finer))

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
