"""Where shadows would fall if the light came from one direction or another, told by depth alone."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

__all__ = ["DIRECTIONS", "as_normals", "directions", "occlusion"]

DIRECTIONS: Final = 48
"""Candidates, 24° apart: about as far as a shadow has to turn to be another one at this size."""

LOWEST: Final = -0.35
"""Least upward part of a candidate: a camera that looks down sees the horizon's lights rise."""

REACH: Final = tuple(0.025 * 1.26**step for step in range(16))
"""Distances at which a ray is held against the depth, in units of the mean depth."""

THICKNESS: Final = 0.08
"""What stands in the picture is taken to be this deep behind its front."""

NEAREST: Final = 0.05
"""Depth that no ray gets nearer than, so that all of them are in front of the camera."""

TURNED: Final = 0.05
"""Cosine over which a surface turns away from the light."""

INSIDE: Final = 0.9999
"""Farthest that is looked up, of a border at 1: what rounds to the border would lie past it."""

SOFT: Final = 0.015
"""Width of the step from lit to shadowed; depth is no better known."""


def directions() -> Tensor:
    """Unit vectors (`DIRECTIONS`, 3) to the candidates: right, up, away; a Fibonacci spiral.

    Rounded to half precision, in which a model may store them: a shadow's edge is sharp.
    """
    index = torch.arange(DIRECTIONS, dtype=torch.float64) + 0.5
    up = 1.0 - (1.0 - LOWEST) * index / DIRECTIONS
    angle = math.pi * (3.0 - math.sqrt(5.0)) * index
    flat = (1.0 - up * up).sqrt()
    return torch.stack([flat * angle.cos(), up, flat * angle.sin()], dim=1).half().float()


def as_normals(towards: Tensor) -> Tensor:
    """Directions (D, 3) in the frame of normals: right, up, towards the camera."""
    return towards * towards.new_tensor([1.0, 1.0, -1.0])


def occlusion(
    place: Tensor, normal: Tensor, hidden: Tensor, extent: Tensor, towards: Tensor
) -> tuple[Tensor, Tensor]:
    """Occlusion of every place of half the latents' size, from every candidate.

    Rays are marched through the depth at the latents' size, as screen-space shadows are. What
    leaves the picture meets nothing.

    Parameters
    ----------
    place : Tensor, shape (B, 3, h, w)
        Where each latent lies: right, up, and away from the mean depth, 1.
    normal : Tensor, shape (B, 3, h, w)
        Right, up, and towards the camera.
    hidden : Tensor, shape (B, 1, h, w)
        Share that is hidden: there the object stands.
    extent : Tensor, shape (B, 2, 1, 1)
        Tangents of half the view, across and up.
    towards : Tensor, shape (D, 3)
        See `directions`.

    Returns
    -------
    by_all, by_hidden : Tensor, shape (B, D, ⌈h/2⌉, ⌈w/2⌉)
        In [0, 1]: by anything, and by what is hidden. The latter only where a surface faces the
        light: what turns away from it has no shadow cast on it, and light from under a floor
        would have the shadow of all that stands there.
    """
    scene = torch.cat([place[:, 2:] + 1.0, hidden], dim=1)
    start = _half_size(place)
    right, up, away = (start + start.new_tensor([0.0, 0.0, 1.0])[:, None, None]).split(1, dim=1)
    faces = _half_size(normal).permute(0, 2, 3, 1) @ as_normals(towards).T
    facing = torch.sigmoid(faces.permute(0, 3, 1, 2) / TURNED)
    steps = torch.tensor(REACH, dtype=towards.dtype, device=towards.device)
    marched = (steps[:, None, None] * towards).flatten(0, 1)
    across, over, along = marched.T[..., None, None].unbind()
    far = (away + along).clamp_min(NEAREST)
    x = (right + across) / (far * extent[:, :1])
    y = -(up + over) / (far * extent[:, 1:])
    front, caster = _looked_up(scene, x, y)
    behind = far - front
    blocked = torch.sigmoid((behind - SOFT) / (SOFT / 2)) * torch.sigmoid(
        (THICKNESS - behind) / (2 * SOFT)
    )
    blocked = blocked * (torch.maximum(x.abs(), y.abs()) < 1).to(blocked.dtype)
    by_all, by_hidden = (
        each.unflatten(1, (len(REACH), len(towards))).amax(dim=1)
        for each in (blocked, blocked * caster)
    )
    return by_all, by_hidden * facing


def _looked_up(planes: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
    """Values (B, S, h, w) of each plane (B, C, H, W), of the nearest latent.

    Between an object's depth and that of the floor behind it lies nothing: halfway there would be a
    surface that is not.
    """
    height, width = planes.shape[-2:]
    column = torch.floor((x.clamp(-INSIDE, INSIDE) + 1.0) * (0.5 * width))
    row = torch.floor((y.clamp(-INSIDE, INSIDE) + 1.0) * (0.5 * height))
    index = (row * width + column).long().flatten(1)
    return tuple(plane.flatten(1).gather(1, index).reshape(x.shape) for plane in planes.unbind(1))


def _half_size(planes: Tensor) -> Tensor:
    return functional.avg_pool2d(planes, 2, ceil_mode=True, count_include_pad=False)
