"""The estimator of a photograph's albedo, normals and depth."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from spotlight_training.networks.blocks import GAMMA, Attention, ResBlock, norm

__all__ = ["IntrinsicsNet"]


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
            norm(widths[0]), nn.SiLU(), nn.Conv2d(widths[0], 16 * 7, 3, padding=1)
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


def _double(x: Tensor, like: Tensor) -> Tensor:
    """Each place twice along both sides, cropped to ``like`` where that is one smaller."""
    x = x.repeat_interleave(2, dim=-2).repeat_interleave(2, dim=-1)
    return x[..., : like.shape[-2], : like.shape[-1]]
