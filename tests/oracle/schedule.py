"""The noise schedule and the DDIM step: Lin et al. 2023 (arXiv 2305.08891), Song et al. 2020."""

from __future__ import annotations

import torch
from torch import Tensor


def scaled_linear_alpha_bar(
    train_steps: int = 1000, beta_start: float = 0.00085, beta_end: float = 0.012
) -> Tensor:
    """ᾱ_t = Π (1 − β_s), with √β linear in s."""
    root_beta = torch.linspace(beta_start**0.5, beta_end**0.5, train_steps, dtype=torch.float64)
    return torch.cumprod(1.0 - root_beta**2, dim=0)


def zero_terminal_snr(alpha_bar: Tensor) -> Tensor:
    """Lin et al., algorithm 1: √ᾱ shifted to end at 0, scaled to start where it did."""
    root = alpha_bar.sqrt()
    shifted = root - root[-1]
    return (shifted * root[0] / shifted[0]) ** 2


def trailing_timesteps(steps: int, train_steps: int = 1000) -> list[int]:
    """Lin et al., table 2, "trailing": from the last train step down, one interval apart."""
    return [round(train_steps - k * train_steps / steps) - 1 for k in range(steps)]


def noise_levels(timesteps: list[int], alpha_bar: Tensor, final: Tensor) -> list[Tensor]:
    """ᾱ before every step, and ᾱ after the last one."""
    return [alpha_bar[t] for t in timesteps] + [final]


def noised(z_0: Tensor, epsilon: Tensor, alpha_bar: Tensor) -> Tensor:
    """noise(z_0, t) = √ᾱ_t·z_0 + √(1−ᾱ_t)·ε."""
    return alpha_bar.sqrt() * z_0 + (1.0 - alpha_bar).sqrt() * epsilon


def v_from_epsilon(epsilon: Tensor, z_t: Tensor, alpha_bar: Tensor) -> Tensor:
    """v = √ᾱ·ε − √(1−ᾱ)·z_0 with z_0 = (z_t − √(1−ᾱ)·ε)/√ᾱ; undefined at ᾱ = 0."""
    z_0 = (z_t - (1.0 - alpha_bar).sqrt() * epsilon) / alpha_bar.sqrt()
    return alpha_bar.sqrt() * epsilon - (1.0 - alpha_bar).sqrt() * z_0


def v_from_z_0(z_0: Tensor, z_t: Tensor, alpha_bar: Tensor) -> Tensor:
    """v = √ᾱ·ε − √(1−ᾱ)·z_0 with ε = (z_t − √ᾱ·z_0)/√(1−ᾱ)."""
    epsilon = (z_t - alpha_bar.sqrt() * z_0) / (1.0 - alpha_bar).sqrt()
    return alpha_bar.sqrt() * epsilon - (1.0 - alpha_bar).sqrt() * z_0


def ddim_step(z_t: Tensor, v: Tensor, alpha_bar_t: Tensor, alpha_bar_s: Tensor) -> Tensor:
    """One deterministic DDIM step from level t to level s, from a v-prediction.

    With v = √ᾱ·ε − √(1−ᾱ)·z_0 (Salimans and Ho 2022): z_0 = √ᾱ·z_t − √(1−ᾱ)·v and
    ε = √ᾱ·v + √(1−ᾱ)·z_t, both defined at ᾱ_t = 0.
    """
    z_0 = alpha_bar_t.sqrt() * z_t - (1.0 - alpha_bar_t).sqrt() * v
    epsilon = alpha_bar_t.sqrt() * v + (1.0 - alpha_bar_t).sqrt() * z_t
    return noised(z_0, epsilon, alpha_bar_s)
