"""A small picture as local functions of a guide: He and Sun 2015, with weights, pixel by pixel.

At each pixel p the coefficients c minimise

    Σ_q G(p−q)·w_q·(y_q − x_q·c)² + Σ_i (ridge_i·W_p + ε)·c_i² − 2·ε·usual·c,

with x_q the guide and a one, G a Gaussian cut off at four deviations whose border is repeated,
W_p = Σ_q G(p−q)·w_q + ε, and ε a millionth of the mean weight: what is usual decides where nothing
is known. Then neighbours agree on their coefficients by their weights, and what is left over is
smoothed and added to them.

A smooth fit is the same for cells instead of pixels, half its reach wide: every sum over q is one
over the means of cells, and nothing is left over.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

FIT_SIGMA = 1.2
LEFTOVER_SIGMA = 0.6
PRIOR = 1e-6
DECODED_BLUR = 0.45
THINNEST = 0.25
BARELY_COVERED = 1e-4
DARK = 0.1
SLOPE_RIDGE = 0.03
LEAST = 0.3
"""Of the albedo's mean square."""


def spread(plane: Tensor, sigma: float) -> Tensor:
    """A (h, w) plane under a normalised Gaussian, its border repeated."""
    size = round(8.0 * sigma + 1.0) | 1
    x = torch.arange(size, dtype=plane.dtype) - size // 2
    bell = torch.exp(-0.5 * (x / sigma) ** 2)
    kernel = torch.outer(bell, bell) / bell.sum() ** 2
    padded = functional.pad(plane[None, None], (size // 2,) * 4, mode="replicate")
    return functional.conv2d(padded, kernel[None, None])[0, 0]


def agreed_coefficients(
    values: Tensor,
    weights: Tensor,
    basis: Tensor,
    ridge: list[float],
    usual: list[float],
    sigma: float,
    cell: float = 1.0,
) -> Tensor:
    """The minimisers, agreed on by neighbours; shape (rows, columns, n).

    Of values and weights (h, w) and a basis (n, h, w), around each cell of a size.
    """
    epsilon = PRIOR * (float(weights.mean()) or 1.0)

    def around(plane: Tensor) -> Tensor:
        return spread(cells(plane, cell), sigma)

    near = around(weights) + epsilon
    normal_matrix = torch.stack(
        [torch.stack([around(weights * a * b) for a in basis], -1) for b in basis], -1
    )
    moments = torch.stack([around(weights * a * values) for a in basis], -1)
    penalty = near[..., None] * torch.tensor(ridge, dtype=values.dtype) + epsilon
    moments = moments + epsilon * torch.tensor(usual, dtype=values.dtype)
    raw = torch.linalg.solve(normal_matrix + torch.diag_embed(penalty), moments)
    weight = cells(weights, cell)
    return torch.stack(
        [
            (spread(weight * raw[..., i], sigma) + epsilon * usual[i]) / near
            for i in range(len(basis))
        ],
        -1,
    )


def guided_fit(
    values: Tensor,
    weights: Tensor,
    basis: Tensor,
    ridge: list[float],
    usual: list[float],
    leftover: Tensor | None = None,
) -> Tensor:
    """Coefficients (h, w, n), agreed on by neighbours; the leftover (n, h, w) shared out to them.

    By default the last one gets all of it.
    """
    epsilon = PRIOR * (float(weights.mean()) or 1.0)
    agreed = agreed_coefficients(values, weights, basis, ridge, usual, FIT_SIGMA).unbind(-1)
    left = values - sum(c * x for c, x in zip(agreed, basis))
    close = spread(weights, LEFTOVER_SIGMA) + epsilon
    if leftover is None:
        leftover = torch.zeros_like(basis)
        leftover[-1] = 1.0
    given = [spread(weights * left * share, LEFTOVER_SIGMA) / close for share in leftover]
    return torch.stack([c + extra for c, extra in zip(agreed, given)], -1)


def smooth_fit(
    values: Tensor,
    weights: Tensor,
    basis: Tensor,
    ridge: list[float],
    usual: list[float],
    reach: float,
) -> Tensor:
    """Coefficients of cells, agreed on by neighbours; shape (rows, columns, n)."""
    cell = max(1.0, reach / 2.0)
    return agreed_coefficients(values, weights, basis, ridge, usual, reach / cell, cell)


def cells(plane: Tensor, size: float) -> Tensor:
    """Means of equal cells of about a size, by the share of each pixel that lies in them."""

    def overlaps(side: int) -> Tensor:
        count = max(1, round(side / size))
        edges = torch.arange(count + 1, dtype=plane.dtype) * (side / count)
        pixels = torch.arange(side, dtype=plane.dtype)
        low = torch.maximum(edges[:-1, None], pixels)
        high = torch.minimum(edges[1:, None], pixels + 1.0)
        return (high - low).clamp(min=0.0) * (count / side)

    rows, columns = (overlaps(side) for side in plane.shape)
    return rows @ plane @ columns.T


def evaluated(coefficients: Tensor, basis: Tensor, size: tuple[int, int]) -> Tensor:
    """The fit on a larger basis (n, H, W): coefficients bilinear between pixel centres."""
    large = functional.interpolate(
        coefficients.permute(2, 0, 1)[None], size=size, mode="bilinear", align_corners=False
    )[0]
    return (large * basis).sum(dim=0)


def straight(premultiplied: Tensor, cover: Tensor) -> Tensor:
    """A premultiplied (n, h, w) map divided by its cover, 0 where next to nothing is covered."""
    return torch.where(cover > BARELY_COVERED, premultiplied / cover, 0.0)


def lambert_basis(albedo: Tensor, normal: Tensor) -> Tensor:
    """What light from a matt surface is linear in: albedo·n and albedo, (4, h, w)."""
    return torch.cat([albedo * normal, albedo[None]])


def object_light(
    own: Tensor, albedo: Tensor, normal: Tensor, mask: Tensor, reach: float = 0.0
) -> list[tuple[Tensor, float]]:
    """Coefficients (h, w, 5) of each channel of the object's own light, all premultiplied.

    With each, what times the albedo the light is not below. Where light is smooth over a reach,
    they are those of a smooth fit.

    The basis is Lambert's and a one for highlights, which get what a dark albedo leaves over; it
    is blurred as a decoder blurs. Pixels count by their squared cover, from a quarter on.
    """
    counted = torch.where(mask >= THINNEST, mask**2, 0.0)
    n = straight(normal, mask)
    fits = []
    for light, colour in zip(own / mask.clamp(min=THINNEST), straight(albedo, mask).clamp(0, 1)):
        planes = lambert_basis(colour * mask, n)
        blurred = torch.stack([spread(plane, DECODED_BLUR) for plane in planes])
        basis = torch.cat(
            [straight(blurred, spread(mask, DECODED_BLUR)), torch.ones_like(mask)[None]]
        )
        energy = float((counted * colour**2).sum())
        shading = float((counted * colour * light).sum()) / energy if energy > 0.0 else 1.0
        slope = SLOPE_RIDGE * energy / max(float(counted.sum()), BARELY_COVERED)
        ridge, usual = [slope, slope, slope, 0.0, 0.3], [0.0, 0.0, 0.0, shading, 0.0]
        if reach > 0.0:
            fits.append((smooth_fit(light, counted, basis, ridge, usual, reach), LEAST * shading))
            continue
        leftover = torch.zeros_like(basis)
        leftover[-2] = colour / (colour**2 + DARK**2)
        leftover[-1] = DARK**2 / (colour**2 + DARK**2)
        fits.append((guided_fit(light, counted, basis, ridge, usual, leftover), 0.0))
    return fits
