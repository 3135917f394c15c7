"""The multistep solvers from their papers, in the half log-SNR λ = log(α/σ).

Lu et al. 2022 (arXiv 2211.01095), algorithm 2, and Zhao et al. 2023 (arXiv 2302.04867), section 3,
both predicting x0 = α·z − σ·v. Zero terminal SNR has no λ; its first level is 2⁻²⁴ instead, and
the last step ends at ᾱ = 1, where λ is infinite and e^{−h} is 0.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial

import torch
from torch import Tensor

from .schedule import ddim_step

TERMINAL = torch.tensor(2.0**-24, dtype=torch.float64)
Step = Callable[[int, Tensor, Tensor], Tensor]
"""(step, z, v) → z at the next level."""


def multistep_levels(levels: list[Tensor]) -> list[Tensor]:
    """ᾱ as multistep solvers need it: λ finite at first, x0 itself at last."""
    return [torch.maximum(level, TERMINAL) for level in levels[:-1]] + [torch.ones_like(TERMINAL)]


def half_log_snr(level: Tensor) -> Tensor:
    """λ = log(α/σ), infinite at ᾱ = 1."""
    return 0.5 * (level.log() - (1.0 - level).log())


def predicted_x0(z: Tensor, v: Tensor, level: Tensor) -> Tensor:
    """x0 = α·z − σ·v."""
    return level.sqrt() * z - (1.0 - level).sqrt() * v


def exponential_step(z: Tensor, x0: Tensor, level: Tensor, after: Tensor, h: Tensor) -> Tensor:
    """Eq. 4.1 of DPM-Solver++ with x0 constant: σ'/σ·z − α'(e^{−h} − 1)·x0."""
    sigma, sigma_after = (1.0 - level).sqrt(), (1.0 - after).sqrt()
    return sigma_after / sigma * z - after.sqrt() * torch.expm1(-h) * x0


def ddim(levels: list[Tensor]) -> Step:
    """A DDIM run, which remembers nothing."""
    return lambda i, z, v: ddim_step(z, v, levels[i], levels[i + 1])


def dpmpp_2m(levels: list[Tensor]) -> Step:
    """Algorithm 2: x0 extrapolated along λ from two predictions; the last step is first order."""
    levels = multistep_levels(levels)
    lambdas = [half_log_snr(level) for level in levels]
    known: list[Tensor] = []

    def step(i: int, z: Tensor, v: Tensor) -> Tensor:
        x0 = predicted_x0(z, v, levels[i])
        h, wanted = lambdas[i + 1] - lambdas[i], x0
        if known and i < len(levels) - 2:
            r = (lambdas[i] - lambdas[i - 1]) / h
            wanted = (1.0 + 0.5 / r) * x0 - 0.5 / r * known[-1]
        known.append(x0)
        return exponential_step(z, wanted, levels[i], levels[i + 1], h)

    return step


def phi(k: int, h: Tensor) -> Tensor:
    """φ_0 = e^h, φ_{k+1}(h) = (φ_k(h) − 1/k!)/h."""
    return torch.exp(h) if k == 0 else (phi(k - 1, h) - 1.0 / factorial(k - 1)) / h


def unipc(levels: list[Tensor]) -> Step:
    """UniPC-2 with B(h) = e^h − 1 in its x0 form, where h stands for −(λ' − λ).

    The corrector of a step needs the prediction at its end, so it is applied when that is known,
    as the difference it makes to the predictor's result.
    """
    levels = multistep_levels(levels)
    lambdas = [half_log_snr(level) for level in levels]
    known: list[Tensor] = []
    steps = len(levels) - 1

    def order(i: int) -> int:
        return min(2, i + 1, steps - i)

    def difference(i: int) -> Tensor:
        """D_1 / r_1 of step i: the earlier prediction against that of its start."""
        r = (lambdas[i - 1] - lambdas[i]) / (lambdas[i + 1] - lambdas[i])
        return (known[i - 1] - known[i]) / r

    def weight(i: int) -> Tensor:
        """α'·B(h) of step i."""
        return levels[i + 1].sqrt() * torch.expm1(lambdas[i] - lambdas[i + 1])

    def predictor(i: int) -> Tensor | float:
        """What UniP-2 adds to the first-order step: ρ = 1/2."""
        return -weight(i) * 0.5 * difference(i) if order(i) == 2 else 0.0

    def corrector(i: int, x0: Tensor) -> Tensor:
        """What UniC adds to the first-order step of i, given x0 at its end."""
        forward = x0 - known[i]
        if order(i) == 1:
            return -weight(i) * 0.5 * forward
        hh = lambdas[i] - lambdas[i + 1]
        r = (lambdas[i - 1] - lambdas[i]) / (lambdas[i + 1] - lambdas[i])
        b_h = torch.expm1(hh)
        system = torch.stack([torch.ones(2, dtype=hh.dtype), torch.stack([r, torch.ones_like(r)])])
        b = torch.stack([hh * phi(2, hh) / b_h, 2.0 * hh * phi(3, hh) / b_h])
        rho = torch.linalg.solve(system, b)
        return -weight(i) * (rho[0] * difference(i) + rho[1] * forward)

    def step(i: int, z: Tensor, v: Tensor) -> Tensor:
        x0 = predicted_x0(z, v, levels[i])
        if i > 0:
            z = z + corrector(i - 1, x0) - predictor(i - 1)
        known.append(x0)
        h = lambdas[i + 1] - lambdas[i]
        return exponential_step(z, x0, levels[i], levels[i + 1], h) + predictor(i)

    return step


SOLVERS = {"ddim": ddim, "dpmpp_2m": dpmpp_2m, "unipc": unipc}
