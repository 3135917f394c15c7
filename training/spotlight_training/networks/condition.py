"""What the renderer is told: the picture as far as it is known, and how it could be lit."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from spotlight_training.networks.blocks import GAMMA, PATCH
from spotlight_training.networks.vae import VAE

__all__ = ["LIGHTS", "ConditionEncoder"]

LIGHTS: Final = 12
"""Ways to light a hidden place: by red, green, blue, each evenly or along an axis of the normals.
Irradiance is nearly linear in the normal (the first spherical harmonics; Ramamoorthi & Hanrahan
2001), so twelve smooth numbers light all the detail that albedo and normals have."""

SURROUNDINGS: Final = ((3, 1.0), (7, 1e-2), (15, 1e-4), (31, 1e-6))
"""Squares, in latents, from which light is taken for a hidden place, and their weights: the nearest
known light decides, and further away counts where nearer by all is hidden."""

EVERYWHERE: Final = 1e-8
"""Weight of all the picture's light; smaller than any square's."""

GREY: Final = 0.1
"""Albedo that grey light is believed with: what is nearly black says little of the light's colour.
Without it dark wooden floors made objects teal."""

VIEW: Final = 0.4663
"""Tangent of half the field of view that is assumed, 50°."""

NEARLY_NOTHING: Final = 1e-6
"""Of depth; keeps the quotient finite where all of it is 0."""

NOTHING_KNOWN: Final = (1e-10, 0.5)
"""Weight and amount of the light that is assumed where no light at all is known."""


class ConditionEncoder(nn.Module):
    """Conditioning maps → condition at latent size.

    The first ``latent`` channels are the latents of the *known picture*: albedo × shading where
    the shading is known, and where it is hidden the albedo under the light of its surroundings.
    In the one the renderer has nothing left to do, in the other only what light and shadow there
    are besides. That guess alone is closer (18 dB on hidden pixels) than albedo under white light
    (14.7 dB), from which a renderer had come to 19.6 dB after 2,600 steps of 256 pixels. The next
    channel is the share of each latent's pixels that are hidden, three say where it lies in space,
    and then comes a learned projection of all maps, which keeps what the latents lose. Last are the
    hidden pixels' latents as each of `LIGHTS` would change them: what the renderer finds of light,
    it says in these.

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
            nn.Conv2d(channels, 2 * learned, PATCH, stride=PATCH),
            nn.SiLU(),
            nn.Conv2d(2 * learned, learned, 3, padding=1),
        )

    @property
    def channels(self) -> int:
        """Channels of the condition."""
        return self.latent + 1 + 3 + self.project[-1].out_channels + LIGHTS * self.latent

    def forward(self, conditioning: Tensor) -> Tensor:
        """Condition (B, E, H/8, W/8) of maps (B, K, H, W)."""
        albedo, shading, mask, normal, depth = (
            conditioning[:, self.slices[name]]
            for name in ("albedo", "shading", "mask", "normal", "depth")
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
        place = places(functional.avg_pool2d(depth, PATCH))
        return torch.cat([encoded, hidden, place, self.project(squashed), lights], dim=1)


def places(depth: Tensor) -> Tensor:
    """Where each latent lies in camera space, in units of the mean depth.

    A light's direction is a difference of places: of a shadow and of what throws it. The field of
    view is not among the maps; at `VIEW` the proportions are right, at others they are stretched.

    Parameters
    ----------
    depth : Tensor, shape (B, 1, h, w)

    Returns
    -------
    Tensor, shape (B, 3, h, w)
        Right, up, and away from the mean depth.
    """
    ones = torch.ones_like(depth)
    column, row = ones.cumsum(dim=3), ones.cumsum(dim=2)
    width, height = column.amax(dim=3, keepdim=True), row.amax(dim=2, keepdim=True)
    reach = 2.0 * VIEW / torch.maximum(width, height)
    right = (column - 0.5 - 0.5 * width) * reach
    up = (0.5 + 0.5 * height - row) * reach
    away = depth / (depth.mean(dim=(2, 3), keepdim=True) + NEARLY_NOTHING)
    return torch.cat([right * away, up * away, away - 1.0], dim=1)


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
            total = total + share * box_mean(x, side)
        return total

    seen, white = around(linear, weight * light), around(albedo, weight)
    believed = GREY * around(known, 0.0)
    grey = seen.mean(dim=1, keepdim=True) / white.mean(dim=1, keepdim=True)
    coarse = (seen + believed * grey) / (white + believed)
    return functional.interpolate(coarse, scale_factor=PATCH, mode="bilinear")


def box_mean(x: Tensor, side: int) -> Tensor:
    """Mean of a square around each latent, zeros beyond the border.

    One side after the other: the widest squares in one go were half of the encoder's time.
    """
    columns = functional.avg_pool2d(x, (side, 1), 1, (side // 2, 0))
    return functional.avg_pool2d(columns, (1, side), 1, (0, side // 2))
