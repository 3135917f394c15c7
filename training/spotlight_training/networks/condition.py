"""What the renderer is told: the picture as far as it is known, and how it could be lit."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from spotlight_training.networks.blocks import GAMMA, PATCH
from spotlight_training.networks.harmonics import HARMONICS, harmonics
from spotlight_training.networks.occlusion import DIRECTIONS, directions, occlusion
from spotlight_training.networks.vae import VAE

__all__ = ["LIGHTS", "SEEN_BY", "ConditionEncoder"]

LIGHTS: Final = 3 * HARMONICS
"""Ways to light a hidden place: by red, green, blue, each as one of the spherical harmonics of the
normals up to the second order. Irradiance is nearly linear in these (Ramamoorthi & Hanrahan 2001),
so 27 smooth numbers light all the detail that albedo and normals have."""

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

SEEN_BY: Final = 2 * DIRECTIONS
"""Channels of occlusion: by anything, and by what is hidden."""

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
    and then comes a learned projection of all maps, which keeps what the latents lose. After it are
    the hidden pixels' latents as each of `LIGHTS` would change them: what the renderer finds of
    light, it says in these. Last is where shadows would fall from each of `DIRECTIONS`, at half the
    latents' size and repeated: what the renderer sees of shadows, it compares with these.

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
        self.register_buffer("towards", directions(), persistent=False)
        channels = max(part.stop for part in slices.values())
        self.project = nn.Sequential(
            nn.Conv2d(channels, 2 * learned, PATCH, stride=PATCH),
            nn.SiLU(),
            nn.Conv2d(2 * learned, learned, 3, padding=1),
        )

    @property
    def channels(self) -> int:
        """Channels of the condition."""
        learned: int = self.project[-1].out_channels
        return self.latent + 1 + 3 + learned + LIGHTS * self.latent + SEEN_BY

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
        ways = (harmonics(2 * normal - 1)[:, :, None] * relit[:, None]).flatten(1, 2)
        kernels = self.analysis.weight.transpose(0, 1).reshape(-1, 1, PATCH, PATCH)
        lights = functional.conv2d(
            ways, kernels.repeat(LIGHTS // 3, 1, 1, 1), stride=PATCH, groups=LIGHTS
        )
        # Depth and shading reach 20 and 1,000; the logarithm keeps them in the network's range
        # and leaves the fill value −1 apart from every known value, which are 0 or more.
        squashed = torch.log(torch.clamp(conditioning + 1.0, min=0.5))
        hidden = functional.avg_pool2d((mask < 0).to(encoded.dtype), PATCH)
        place, extent = places(functional.avg_pool2d(depth, PATCH))
        upright = functional.avg_pool2d(2 * normal - 1, PATCH)
        blocked = torch.cat(occlusion(place, upright, hidden, extent, self.towards), dim=1)
        blocked = functional.interpolate(blocked, scale_factor=2.0)
        blocked = blocked[..., : hidden.shape[-2], : hidden.shape[-1]]
        return torch.cat([encoded, hidden, place, self.project(squashed), lights, blocked], dim=1)


def places(depth: Tensor) -> tuple[Tensor, Tensor]:
    """Where each latent lies in camera space, in units of the mean depth.

    A light's direction is a difference of places: of a shadow and of what throws it. The field of
    view is not among the maps; at `VIEW` the proportions are right, at others they are stretched,
    as is the direction of a light then.

    Parameters
    ----------
    depth : Tensor, shape (B, 1, h, w)

    Returns
    -------
    place : Tensor, shape (B, 3, h, w)
        Right, up, and away from the mean depth.
    extent : Tensor, shape (B, 2, 1, 1)
        Tangents of half the view, across and up.
    """
    ones = torch.ones_like(depth)
    column, row = ones.cumsum(dim=3), ones.cumsum(dim=2)
    size = torch.cat([column.amax(dim=(2, 3), keepdim=True), row.amax(dim=(2, 3), keepdim=True)], 1)
    extent = VIEW * size / size.amax(dim=1, keepdim=True)
    across = (2.0 * torch.cat([column, row], dim=1) - 1.0) / size - 1.0
    right, down = (across * extent).split(1, dim=1)
    away = depth / (depth.mean(dim=(2, 3), keepdim=True) + NEARLY_NOTHING)
    return torch.cat([right * away, -down * away, away - 1.0], dim=1), extent


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

    x = functional.avg_pool2d(torch.cat([linear, albedo, known], dim=1) * known, PATCH)
    total = EVERYWHERE * x.mean(dim=(2, 3), keepdim=True)
    for side, share in SURROUNDINGS:
        total = total + share * box_mean(x, side)
    seen, white, believed = total.split([3, 3, 1], dim=1)
    seen, white, believed = seen + weight * light, white + weight, GREY * believed
    grey = seen.mean(dim=1, keepdim=True) / white.mean(dim=1, keepdim=True)
    coarse = (seen + believed * grey) / (white + believed)
    return functional.interpolate(coarse, scale_factor=PATCH, mode="bilinear")


def box_mean(x: Tensor, side: int) -> Tensor:
    """Mean of a square around each latent, zeros beyond the border.

    One side after the other: the widest squares in one go were half of the encoder's time.
    """
    columns = functional.avg_pool2d(x, (side, 1), 1, (side // 2, 0))
    return functional.avg_pool2d(columns, (1, side), 1, (0, side // 2))
