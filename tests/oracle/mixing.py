"""Several lights in one picture: light is additive, the photograph is all there is of it."""

from __future__ import annotations

from torch import Tensor


def shares(weights: Tensor, colours: Tensor) -> Tensor:
    """ω_i = w_i·c_i / Σ_j w_j·c_j, by channel: (lights,) and (lights, 3) → (lights, 3)."""
    given = weights[:, None] * colours
    return given / given.sum(dim=0)


def mixed(pictures: list[Tensor], omega: Tensor) -> Tensor:
    """out = Σ_i ω_i·out_i of linear (3, H, W) pictures."""
    return sum(share[:, None, None] * picture for share, picture in zip(omega, pictures))


def shadows_mixed(background: Tensor, ratios: list[Tensor], omega: Tensor) -> Tensor:
    """B·(1 − Σ_i ω_i·(1 − ρ_i)): each shadow takes away its own light's share."""
    taken = sum(share[:, None, None] * (1.0 - ratio) for share, ratio in zip(omega, ratios))
    return background * (1.0 - taken)
