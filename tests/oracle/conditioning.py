"""From the maps of a background and an object to what the two branches are conditioned on."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .masks import square_dilation

FILL = -1.0
SHADOW_THRESHOLD = 0.1
FARTHEST = 20.0
ALBEDO_FLOOR = 1e-6
SHADING_RANGE = (1e-5, 1e3)


@dataclass(frozen=True)
class Maps:
    """One layer's maps; the object's are premultiplied by its mask."""

    albedo: Tensor
    normal: Tensor
    depth: Tensor
    roughness: Tensor | None = None
    metallic: Tensor | None = None


def over(premultiplied: Tensor, background: Tensor, alpha: Tensor) -> Tensor:
    """The alpha composite of a premultiplied map over another."""
    return premultiplied + (1.0 - alpha) * background


def aligned_to_footprint(
    d_obj: Tensor, alpha: Tensor, d_foot: Tensor, footprint: Tensor, d_bg: Tensor
) -> Tensor:
    """Premultiplied object depth under the (m, c) that minimise Σ (m·d_foot + c − d_bg)².

    The sum runs over the footprint's pixels.
    """
    design = torch.stack([d_foot[footprint], torch.ones_like(d_foot[footprint])], dim=1)
    m, c = torch.linalg.lstsq(design, d_bg[footprint][:, None]).solution.flatten()
    return m * d_obj + c * alpha


def aligned_to_nearest(d_obj: Tensor, alpha: Tensor, inside: Tensor, d_bg: Tensor) -> Tensor:
    """Premultiplied object depth, moved until its nearest point meets the nearest background."""
    straight = d_obj[inside] / alpha[inside]
    shift = d_bg[inside].min() - straight.min()
    return d_obj + shift * alpha


def guiding_shadow(m_shw: Tensor, m_obj: Tensor) -> Tensor:
    """The shadow on the background: what falls under the object is not guidance."""
    return m_shw * (1.0 - m_obj)


def masked_region(m_shw: Tensor, m_obj: Tensor) -> Tensor:
    """Where shading is unknown: in the guiding shadow, and on the object dilated by one pixel."""
    return (m_shw > SHADOW_THRESHOLD) | (square_dilation(m_obj) > 0.0)


def masked_shading(background: Tensor, albedo: Tensor, region: Tensor) -> Tensor:
    """The gamma-encoded background ÷ albedo, −1 inside the region."""
    shading = (background / (albedo + ALBEDO_FLOOR)).clamp(*SHADING_RANGE)
    return torch.where(region, torch.full_like(shading, FILL), shading)


def shading_mask(region: Tensor, like: Tensor) -> Tensor:
    """1 where shading is known, −1 inside the region."""
    return torch.where(region, -1.0, 1.0).to(like.dtype)


def rough_composite(
    background: Tensor, albedo_obj: Tensor, alpha: Tensor, m_shw: Tensor, opacity: float = 1.0
) -> Tensor:
    """g: the object's albedo over the background darkened by the guiding shadow.

    `background` is gamma-encoded, as in every image the VAE sees, and so is the result; the
    albedo enters as the map it is.
    """
    return over(albedo_obj, background * (1.0 - opacity * m_shw), alpha)


def gamma_encoded(linear: Tensor) -> Tensor:
    """clip(x, 0, 1)^(1/2.2), the encoding the renderer was trained on."""
    return linear.clamp(0.0, 1.0) ** (1.0 / 2.2)


def for_encoder(image: Tensor) -> Tensor:
    """[0, 1] → [−1, 1]."""
    return 2.0 * image.clamp(0.0, 1.0) - 1.0


def conditioning(
    order: tuple[str, ...],
    background: Tensor,
    behind: Maps,
    in_front: Maps,
    alpha: Tensor,
    aligned_depth: Tensor,
    region: Tensor,
) -> Tensor:
    """One branch's conditioning image, its channels in the checkpoint's order."""
    composited = {
        "depth": over(aligned_depth, behind.depth, alpha).clamp(0.0, FARTHEST),
        "normal": over(in_front.normal, behind.normal, alpha),
        "diffuse": over(in_front.albedo, behind.albedo, alpha),
        "shading": masked_shading(background, behind.albedo, region),
        "mask": shading_mask(region, background),
    }
    if behind.roughness is not None and in_front.roughness is not None:
        composited["roughness"] = over(in_front.roughness, behind.roughness, alpha)
    if behind.metallic is not None and in_front.metallic is not None:
        composited["metallic"] = over(in_front.metallic, behind.metallic, alpha)
    return torch.cat([composited[name] for name in order])
