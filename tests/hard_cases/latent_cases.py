"""Schedules, conversions, guidance, masks and blending on the latent grid."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from oracle import masks as mask_method
from oracle import schedule as schedule_method
from oracle.guidance import masked_guidance, rescaled_guidance
from oracle.loop import blended

from spotlight_bench.stability_cases import MASKS, mask_named
from spotlight_runtime.diffusion import blending, guidance
from spotlight_runtime.diffusion.noise import MAX_SEED, gaussian
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.networks.models import predictor
from spotlight_spec import ScheduleSpec

from .case import Case, Refusal, exact

__all__ = ["CASES", "REFUSALS"]

LATENTS = (1, 4, 6, 8)
ROUNDING = 4.0 * 2.0**-24
"""A few operations of float32."""
DENORMAL = 4.0 * 2.0**-149
"""What few operations on denormals round by."""


def unit(seed: int, scale: float = 1.0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(LATENTS, dtype=np.float32)
    return noise * np.float32(scale)


def weights(mask: str) -> np.ndarray:
    return mask_named(mask, LATENTS[2:])[None, None]


def _levels(steps: int) -> tuple[np.ndarray, np.ndarray]:
    alpha_bar = schedule_method.zero_terminal_snr(schedule_method.scaled_linear_alpha_bar())
    timesteps = schedule_method.trailing_timesteps(steps)
    levels = schedule_method.noise_levels(timesteps, alpha_bar, alpha_bar[0])
    return Schedule.trailing(ScheduleSpec(), steps).alpha_bar, torch.stack(levels).numpy()


def _guided(gamma: float, mask: str, scale: float, apart: float) -> tuple[np.ndarray, np.ndarray]:
    """Predictions of a scale, the second a little apart from the first."""
    v_pos = unit(0, scale)
    v_neg = v_pos + unit(1, scale * apart)
    expected = masked_guidance(exact(v_pos), exact(v_neg), exact(weights(mask)), gamma)
    return guidance.masked_guidance(v_pos, v_neg, weights(mask), gamma), expected.numpy()


def _rescaled(v: np.ndarray, mask: str, phi: float) -> tuple[np.ndarray, np.ndarray]:
    expected = rescaled_guidance(exact(v), exact(unit(3)), exact(weights(mask)), phi)
    return guidance.rescale_guidance(v, unit(3), weights(mask), phi), expected.numpy()


def _unchanged(v: np.ndarray, v_pos: np.ndarray, mask: str) -> tuple[np.ndarray, np.ndarray]:
    return guidance.rescale_guidance(v, v_pos, weights(mask), 1.0), v


def _jittered(value: float) -> np.ndarray:
    """That value and its neighbour, alternating."""
    both = np.float32([value, np.nextafter(np.float32(value), np.float32(1.0))])
    return np.resize(both, LATENTS)


def _blended(beta: float, mask: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    z, composite = unit(4, scale), unit(5)
    expected = blended(exact(z), exact(composite), exact(mask), beta)
    return blending.blend_shadow(z, composite, mask, beta), expected.numpy()


def _noised(alpha_bar: float, scale: float) -> tuple[np.ndarray, np.ndarray]:
    clean, noise = unit(6, scale), unit(7, scale)
    level = torch.tensor(alpha_bar, dtype=torch.float64)
    expected = schedule_method.noised(exact(clean), exact(noise), level)
    return blending.add_noise(clean, noise, alpha_bar), expected.numpy()


def _shadow_mask(shadow: str, covered: str, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    m_shw, m_obj = mask_named(shadow, size), mask_named(covered, size)
    latent = (size[0] // 8, size[1] // 8)
    expected = mask_method.latent_shadow_mask(exact(m_shw)[None], exact(m_obj)[None], latent)
    return blending.latent_shadow_mask(m_shw, m_obj, 8), expected[0].numpy()


def _guidance_mask(covered: str, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    m_obj = mask_named(covered, size)
    latent = (size[0] // 8, size[1] // 8)
    expected = mask_method.guidance_mask(exact(m_obj)[None], latent)
    return blending.downsample_antialiased(m_obj, 8), expected[0].numpy()


def _as_v(kind: str, timestep: int, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """What a network says about ε or x0, as the v that the loop knows."""
    spec = ScheduleSpec(prediction_type=kind)
    said, z = unit(8, scale), unit(9)
    predict = predictor({"denoiser": lambda **_: {"prediction": said}}, z, spec)
    alpha_bar = schedule_method.zero_terminal_snr(schedule_method.scaled_linear_alpha_bar())
    convert = {"epsilon": schedule_method.v_from_epsilon, "sample": schedule_method.v_from_z_0}
    expected = convert[kind](exact(said), exact(z), alpha_bar[timestep])
    return predict(z, timestep), expected.numpy()


def _seeded(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two draws of one seed; and they are noise: neither constant nor of another seed."""
    first, again = (gaussian(seed, "initial", (4, 8, 8)) for _ in range(2))
    assert 0.5 < first.std() < 1.5
    assert not np.array_equal(first, gaussian(seed ^ 1, "initial", (4, 8, 8)))
    return first, again


SIZES = {"8×8": (8, 8), "40×24": (40, 24), "16×128": (16, 128), "264×376": (264, 376)}
CASES = [
    *(
        Case(
            f"levels of {steps} steps",
            "the first is exactly 0, and rounding timesteps must not repeat or skip one",
            partial(_levels, steps),
            relative=1e-14,
        )
        for steps in (1, 2, 3, 50, 999, 1000)
    ),
    *(
        Case(
            f"guidance by γ = {gamma:g} of predictions that differ by {apart:g}",
            "a small difference of large numbers, amplified",
            partial(_guided, gamma, mask, 1.0, apart),
            relative=ROUNDING * max(gamma, 1.0),
        )
        for gamma in (0.0, 1.0, 3.0, 15.0)
        for mask, apart in (("soft", 1e-6), ("full", 1.0))
    ),
    Case(
        "guidance of predictions of 1e4",
        "what a quantised model says when it saturates",
        partial(_guided, 15.0, "checker", 1e4, 2.0),
        relative=15.0 * ROUNDING,
    ),
    Case(
        "guidance of denormal predictions",
        "differences of few digits",
        partial(_guided, 15.0, "soft", 1e-40, 1.0),
        absolute=15.0 * DENORMAL,
    ),
    *(
        Case(
            f"rescale on an object that is {mask}",
            "deviations over few or no values, or over all",
            partial(_rescaled, unit(2, 15.0), mask, 0.7),
            relative=ROUNDING,
        )
        for mask in ("empty", "full", "pixel", "column", "soft", "checker", "denormal")
    ),
    Case(
        "rescale of predictions of 1e4 with deviations of 1",
        "the deviation is a small difference of large numbers",
        partial(_rescaled, unit(2) + np.float32(1e4), "full", 0.7),
        relative=1e-6,
    ),
    *(
        Case(
            f"rescale of a prediction that is {value:g} everywhere",
            "no deviation to divide by but what rounding makes of a mean: documented as unchanged",
            partial(_unchanged, np.full(LATENTS, value, np.float32), unit(3), "full"),
            relative=0.0,
        )
        for value in (0.0, 0.1, -1.0 / 3.0, 1e4, 1e-40)
    ),
    Case(
        "rescale of a prediction that is constant but for its last digit",
        "its deviation is rounding, and so would be ten million times the prediction",
        partial(_unchanged, _jittered(0.1), unit(3), "full"),
        relative=0.0,
    ),
    Case(
        "rescale to a constant prediction",
        "nothing to restore, and 0 would erase the prediction: documented as unchanged",
        partial(_unchanged, unit(2), np.full(LATENTS, 0.1, np.float32), "full"),
        relative=0.0,
    ),
    *(
        Case(
            f"blending by β = {beta:g} where {mask}",
            "an edge weighs twice β, which is more than the whole from β = 0.5 on",
            partial(_blended, beta, np.float32(2.0) * weights(mask), scale),
            relative=ROUNDING,
        )
        for beta in (0.0, 0.05, 0.5, 1.0)
        for mask, scale in (("full", 1.0), ("soft", 1e4), ("denormal", 1.0))
    ),
    *(
        Case(
            f"noise at ᾱ = {alpha_bar!r} on latents of {scale:g}",
            "ᾱ of 0 and 1 are ends of a square root",
            partial(_noised, alpha_bar, scale),
            relative=ROUNDING,
            absolute=DENORMAL,
        )
        for alpha_bar in (0.0, 2.0**-24, 0.5, 1.0 - 2.0**-53, 1.0)
        for scale in (1.0, 1e4, 1e-40)
    ),
    *(
        Case(
            f"latent shadow mask: {shadow} beside {covered}, {name}",
            "thresholds, and a cross-shaped kernel that meets the end of the map",
            partial(_shadow_mask, shadow, covered, size),
            relative=0.0,
        )
        for shadow in MASKS
        for covered in ("empty", "full", "disc", "pixel", "denormal")
        for name, size in SIZES.items()
    ),
    *(
        Case(
            f"guidance mask: {covered}, {name}",
            "antialiasing that meets the end of the map",
            partial(_guidance_mask, covered, size),
            relative=ROUNDING,
        )
        for covered in MASKS
        for name, size in SIZES.items()
    ),
    *(
        Case(
            f"v from {kind} of {scale:g} at timestep {timestep}",
            "a division by √ᾱ or √(1−ᾱ) near its end",
            partial(_as_v, kind, timestep, scale),
            relative=ROUNDING,
        )
        for kind, timestep, scale in (
            ("epsilon", 0, 1.0),
            ("epsilon", 998, 1.0),
            ("epsilon", 998, 1e4),
            ("sample", 999, 1.0),
            ("sample", 0, 1.0),
        )
    ),
    *(
        Case(
            f"noise of seed {seed}",
            "an end of the range that seeds are taken from",
            partial(_seeded, seed),
            relative=0.0,
        )
        for seed in (0, 1, 2**32, MAX_SEED)
    ),
]
REFUSALS = [
    *(
        Refusal(
            f"{steps} steps",
            "no step, or more than the schedule has",
            partial(Schedule.trailing, ScheduleSpec(), steps),
            InvalidInputError,
            rf"steps: expected a whole number from 1 to 1000, got {steps}",
        )
        for steps in (0, -1, 1001)
    ),
    *(
        Refusal(
            f"seed {seed}",
            "beyond what seeds are taken from",
            partial(gaussian, seed, "initial", (1,)),
            InvalidInputError,
            "seed: expected a whole number from 0 to",
        )
        for seed in (-1, MAX_SEED + 1, 0.5, True, None)
    ),
    Refusal(
        "ε at zero terminal SNR",
        "√ᾱ is 0 and to be divided by",
        lambda: _as_v("epsilon", 999, 1.0),
        InvalidInputError,
        "undefined at zero terminal SNR",
    ),
]
