"""Which of the directions light could come from agrees with the shadows that are seen."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from spotlight_training.networks.blocks import norm
from spotlight_training.networks.harmonics import lambertian
from spotlight_training.networks.occlusion import DIRECTIONS, as_normals, directions

__all__ = ["Found", "LightFinder"]

SHARPNESS: Final = 15.0
"""Of the guess, to begin with."""

MIXED: Final = 128
"""Units that learn what likeness to all candidates together says."""

FREE_UP_TO: Final = -0.4
"""Logit of the object's share up to which a place can have its shadow: two fifths."""

FREE_STEEPNESS: Final = 4.0
"""How decided that is: what is half of the object would look shadowed by it from behind."""

NEARLY_NOTHING: Final = 1e-4
"""Squared length; what is as even as that is like nothing."""


class Found(NamedTuple):
    """What was found, for whoever teaches it.

    Attributes
    ----------
    shadow, object_mask : Tensor, shape (B, 1, h, w)
        How shadowed by the object each place seems, and how much of the object; in [0, 1].
    likely : Tensor, shape (B, D)
        Logarithm of how likely light comes from each candidate.
    """

    shadow: Tensor
    object_mask: Tensor
    likely: Tensor


class LightFinder(nn.Module):
    """Compares the shadow that is seen with those there could be, and tells each place the light.

    A matched filter: a map of the object's shadow is held against each candidate's, and where light
    comes from is guessed from nothing but the likenesses. What noise hides in every one place shows
    in the sum over the right shadow. A network that was free to guess from all it knew (sixteen
    maps, two layers) learned from the shadows in plain sight: on relights, where none is, it erred
    by 70° when its own map of the shadow told the direction to 24°.

    Each place is then told how shadowed it is, from where the light comes that reaches it, from
    where all of it comes, and how sure that is.

    Parameters
    ----------
    channels, embedding : int
        Of the features, and of the timestep's embedding.
    """

    def __init__(self, channels: int, embedding: int) -> None:
        super().__init__()
        self.register_buffer("towards", directions(), persistent=False)
        lit = lambertian(as_normals(directions())).T.contiguous()
        self.register_buffer("lit", lit, persistent=False)
        self.evidence = nn.Sequential(norm(channels), nn.Conv2d(channels, 2, 1))
        self.sharpness = nn.Linear(embedding, 1)
        self.mix = nn.Sequential(
            nn.Linear(2 * DIRECTIONS + embedding, MIXED), nn.SiLU(), nn.Linear(MIXED, DIRECTIONS)
        )
        self.tell = nn.Conv2d(2 + 3 + 3 + 3 + 2, channels, 1)
        for layer in (self.sharpness, self.mix[-1], self.tell):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        nn.init.constant_(self.sharpness.bias, math.log(SHARPNESS))

    def forward(
        self, x: Tensor, embedding: Tensor, blocked: Tensor
    ) -> tuple[Tensor, Tensor, Found]:
        """Compare.

        Parameters
        ----------
        x : Tensor, shape (B, C, h, w)
        embedding : Tensor, shape (1 or B, E)
        blocked : Tensor, shape (B, 2·D, h, w)
            See `occlusion`.

        Returns
        -------
        told : Tensor, shape (B, C, h, w)
            To be added to the features.
        direct : Tensor, shape (B, `HARMONICS`, h, w)
            Light that reaches each place, of one lamp as bright as 1.
        found : Found
        """
        batch, _, height, width = x.shape
        by_all, by_hidden = blocked.float().flatten(2).split(DIRECTIONS, dim=1)
        said = self.evidence(x).float()
        shadow, object_mask = said.sigmoid().split(1, dim=1)
        free = (FREE_STEEPNESS * (FREE_UP_TO - said[:, 1:])).sigmoid().flatten(2)
        seen, candidates = _centred(shadow.flatten(2)), _centred(by_hidden * free)
        strength, size = _length(seen), _length(candidates)
        likeness = candidates @ seen.transpose(1, 2) / (size * strength)
        vectors = torch.cat([likeness, size], dim=1).flatten(1)
        known = torch.cat([vectors, embedding.expand(batch, -1)], dim=1)
        logits = self.sharpness(embedding).float().exp() * likeness[:, :, 0] + self.mix(known)
        likely = functional.log_softmax(logits.float(), dim=1)
        guess = likely.exp()[:, None]
        weighted = guess * self.towards.T
        direct = (guess * self.lit) @ (1 - by_all)
        everywhere = torch.cat(
            [
                weighted.sum(dim=2, keepdim=True),
                guess.square().sum(dim=2, keepdim=True),
                guess @ likeness,
                strength,
            ],
            dim=1,
        )
        told = torch.cat(
            [
                guess @ by_all,
                guess @ by_hidden,
                weighted @ (1 - by_all),
                everywhere.expand(-1, -1, height * width),
            ],
            dim=1,
        ).reshape(batch, -1, height, width)
        told = self.tell(torch.cat([told, shadow, object_mask], dim=1).to(x.dtype))
        direct = direct.reshape(batch, -1, height, width)
        return told, direct, Found(shadow, object_mask, likely)


def _centred(planes: Tensor) -> Tensor:
    return planes - planes.mean(dim=2, keepdim=True)


def _length(planes: Tensor) -> Tensor:
    return (planes.square().sum(dim=2, keepdim=True) + NEARLY_NOTHING).sqrt()
