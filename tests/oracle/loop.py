"""The whole loop, a branch at a time: sections 4.2 and 4.3 of the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from .guidance import masked_guidance, rescaled_guidance
from .schedule import ddim_step, noise_levels, noised
from .solvers import SOLVERS, multistep_levels

Fidelity = Literal["release", "paper"]
Predict = Callable[[Tensor, int, Tensor], Tensor]
"""(z_t, t, conditioning of one branch) → v."""


@dataclass(frozen=True)
class Branch:
    """What one branch is given: its conditioning, E(g)·s, and its latent shadow mask."""

    conditioning: Tensor
    composite_latents: Tensor
    shadow_mask: Tensor


@dataclass(frozen=True)
class Draws:
    """Every random array of a run: the first latents, and one draw for each blend."""

    initial: Tensor
    blends: list[Tensor]


@dataclass(frozen=True)
class Knobs:
    """γ, β, φ, whose reading of the method is followed, and who solves the equation."""

    gamma: float = 3.0
    beta: float = 0.05
    phi: float = 0.0
    fidelity: Fidelity = "release"
    solver: str = "ddim"


def blend_level(step: int, levels: list[Tensor], fidelity: Fidelity) -> Tensor:
    """ᾱ of what is blended in after `step`: the step's own, or that of the latents it joins."""
    return levels[step] if fidelity == "release" else levels[step + 1]


def blended(z: Tensor, noised_composite: Tensor, mask: Tensor, beta: float) -> Tensor:
    """Eq. 1: z̃_t = (1 − β·m_shw,↓)·z_t + β·m_shw,↓·noise(E(g), t).

    It is a mixture: edges, whose mask is 2, take over wholly from β = 0.5 on, and never more.
    """
    weight = (beta * mask).clamp(max=1.0)
    return (1.0 - weight) * z + weight * noised_composite


def renderer_alone(
    predict: Predict,
    conditioning: Tensor,
    initial: Tensor,
    timesteps: list[int],
    alpha_bar: Tensor,
    final_alpha_bar: Tensor,
) -> Tensor:
    """The backbone without SpotLight, as for the no-shadow prediction: its last latents."""
    levels = noise_levels(timesteps, alpha_bar, final_alpha_bar)
    z = initial
    for step, t in enumerate(timesteps):
        z = ddim_step(z, predict(z, t, conditioning), levels[step], levels[step + 1])
    return z


def spotlight(
    predict: Predict,
    positive: Branch,
    negative: Branch,
    m_obj: Tensor,
    draws: Draws,
    timesteps: list[int],
    alpha_bar: Tensor,
    final_alpha_bar: Tensor,
    knobs: Knobs,
) -> list[tuple[Tensor, Tensor]]:
    """Both branches' latents after every step, blending included.

    The last pair is unblended: what is blended there could no longer be refined.
    """
    levels = noise_levels(timesteps, alpha_bar, final_alpha_bar)
    step_pos, step_neg = SOLVERS[knobs.solver](levels), SOLVERS[knobs.solver](levels)
    if knobs.solver != "ddim":
        levels = multistep_levels(levels)
    z_pos, z_neg = draws.initial, draws.initial
    history = []
    for step, t in enumerate(timesteps):
        v_pos = predict(z_pos, t, positive.conditioning)
        v_neg = predict(z_neg, t, negative.conditioning)
        v = masked_guidance(v_pos, v_neg, m_obj, knobs.gamma)
        if knobs.phi > 0.0:
            v = rescaled_guidance(v, v_pos, m_obj, knobs.phi)
        z_pos, z_neg = step_pos(step, z_pos, v), step_neg(step, z_neg, v)
        if step < len(timesteps) - 1:
            epsilon = draws.blends[step] if knobs.fidelity == "release" else draws.initial
            level = blend_level(step, levels, knobs.fidelity)
            shadowed = noised(positive.composite_latents, epsilon, level)
            z_pos = blended(z_pos, shadowed, positive.shadow_mask, knobs.beta)
            opposite = noised(negative.composite_latents, epsilon, level)
            z_neg = blended(z_neg, opposite, negative.shadow_mask, knobs.beta)
        history.append((z_pos, z_neg))
    return history
