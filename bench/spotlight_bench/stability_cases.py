"""Runs of the denoising loop that are hard on its arithmetic, each with the reason why.

A case is data: its inputs are drawn from its seed, in float32, so that every precision and the
oracle start from the same numbers. `tests/hard_cases` holds the runtime to the oracle on them; the
stability report measures how errors grow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from spotlight_bench.stability_network import CHANNELS, CONDITION_CHANNELS
from spotlight_runtime.diffusion.blending import downsample_antialiased, latent_shadow_mask
from spotlight_runtime.diffusion.noise import MAX_SEED, gaussian
from spotlight_runtime.diffusion.sampler import Fidelity, LoopInputs
from spotlight_runtime.diffusion.solvers import SolverName

__all__ = ["LOOP_CASES", "MASKS", "LoopCase", "MaskName", "mask_named"]

FloatArray = npt.NDArray[np.floating[Any]]
MaskName = Literal[
    "empty", "full", "pixel", "column", "disc", "soft", "left", "border", "checker", "denormal"
]
MASKS: Final[tuple[MaskName, ...]] = get_args(MaskName)
DOWNSCALE: Final = 8
"""Pixels per latent."""
CONDITION_STREAM: Final = 100
"""Index of the noise that stands for conditions, apart from those of the branches' composites."""


@dataclass(frozen=True, slots=True)
class LoopCase:
    """One run of `shadow_guided`.

    Attributes
    ----------
    name, why : str
        What it is called, and why it is hard.
    steps, solver, gamma, beta, rescale, fidelity, seed
        As in `spotlight_runtime.RelightOptions`.
    size : tuple of int
        Latent height and width.
    object_mask, shadow, opposite : str
        See `mask_named`; a shadow may lie under the object.
    scale : float
        Of the starting latents, which are unit Gaussian noise times it.
    composite_scale : float
        Likewise, of the composites that are blended in.
    full : bool
        Too slow for every day.
    """

    name: str
    why: str
    steps: int = 50
    solver: SolverName = "ddim"
    gamma: float = 3.0
    beta: float = 0.05
    rescale: float = 0.0
    fidelity: Fidelity = "paper"
    seed: int = 469
    size: tuple[int, int] = (8, 8)
    object_mask: MaskName = "disc"
    shadow: MaskName = "left"
    opposite: MaskName = "border"
    scale: float = 1.0
    composite_scale: float = 1.0
    full: bool = False

    def condition(self) -> FloatArray:
        """What the two branches are conditioned on, unit noise: (2, CONDITION_CHANNELS, h, w)."""
        return gaussian(
            self.seed, "posterior", (2, CONDITION_CHANNELS, *self.size), CONDITION_STREAM
        )

    def inputs(self, dtype: npt.DTypeLike = np.float32) -> LoopInputs:
        """Float32 numbers, in arrays of ``dtype``."""
        pixels = (self.size[0] * DOWNSCALE, self.size[1] * DOWNSCALE)
        inserted = mask_named(self.object_mask, pixels)
        shadows = [mask_named(name, pixels) for name in (self.shadow, self.opposite)]
        masks = [latent_shadow_mask(shadow, inserted, DOWNSCALE)[None] for shadow in shadows]
        latent = (CHANNELS, *self.size)
        composites = [gaussian(self.seed, "posterior", latent, branch) for branch in (0, 1)]
        start = gaussian(self.seed, "initial", (1, *latent)) * np.float32(self.scale)
        noise = start  # the paper blends with the noise that the latents started from
        if self.fidelity == "release" and self.steps > 1:
            noise = np.stack(
                [gaussian(self.seed, "step", latent, index) for index in range(self.steps - 1)]
            )
        arrays = {
            "conditioning": self.condition(),
            "composite_latents": np.stack(composites) * np.float32(self.composite_scale),
            "shadow_mask": np.stack(masks),
            "guidance_mask": downsample_antialiased(inserted, DOWNSCALE)[None, None],
            "initial_noise": start,
            "step_noise": noise,
        }
        return LoopInputs(**{name: array.astype(dtype) for name, array in arrays.items()})


def mask_named(name: MaskName, size: tuple[int, int]) -> npt.NDArray[np.float32]:
    """A mask of shape ``size`` in [0, 1].

    ``disc`` has a soft edge, ``left`` is a soft half, ``border`` is one latent wide along all four
    sides, ``checker`` and ``soft`` are not binary, ``denormal`` is 1e-40 everywhere.
    """
    height, width = size
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    if name == "disc":
        across = np.hypot(rows - height / 2 + 0.5, columns - width / 2 + 0.5)
        mask = np.clip(0.3 * min(size) - across + 0.5, 0.0, 1.0)
    elif name == "left":
        mask = np.clip((0.4 * width - columns) / max(0.1 * width, 1.0), 0.0, 1.0)
    elif name == "border":
        inside = np.minimum(
            np.minimum(rows, height - 1 - rows), np.minimum(columns, width - 1 - columns)
        )
        mask = np.where(inside < DOWNSCALE, 1.0, 0.0)
    elif name == "checker":
        mask = 0.25 + 0.5 * ((rows + columns) % 2)
    elif name == "soft":
        mask = np.random.default_rng(0).random(size)
    elif name == "denormal":
        mask = np.full(size, 1e-40)
    else:
        mask = np.full(size, 1.0 if name == "full" else 0.0)
        if name == "pixel":
            mask[height // 2 | 3, width // 2 | 3] = 1.0  # one that downsampling looks at
        elif name == "column":
            mask[:, width // 3] = 1.0
    return mask.astype(np.float32)


def _step_cases() -> list[LoopCase]:
    reasons = {
        1: "zero terminal SNR is the only level: the picture comes from ᾱ = 0 at once",
        2: "half of all noise goes in one step; multistep solvers have one prediction to remember",
        3: "1000 is no multiple of 3, and a second-order step stands between two first-order ones",
        50: "what the paper's other backbone takes: rounding errors of fifty steps add up",
        1000: "every train step: log-SNR steps are small differences, and errors of all add up",
    }
    solvers: tuple[SolverName, ...] = ("ddim", "dpmpp_2m", "unipc")
    return [
        LoopCase(f"{solver}, {steps} steps", why, steps=steps, solver=solver, full=steps == 1000)
        for steps, why in reasons.items()
        for solver in solvers
    ]


LOOP_CASES: Final[tuple[LoopCase, ...]] = (
    *_step_cases(),
    LoopCase("γ = 0", "the negative branch alone steers the object", gamma=0.0),
    LoopCase("γ = 1", "no guidance: the negative branch must not be felt, to the bit", gamma=1.0),
    LoopCase("γ = 7", "differences of nearly equal predictions, amplified six times", gamma=7.0),
    LoopCase("γ = 15", "amplified fourteen times, the most a user should ask for", gamma=15.0),
    LoopCase(
        "γ = 15, rescaled",
        "a quotient of deviations of which one is fourteen times too large",
        gamma=15.0,
        rescale=1.0,
    ),
    LoopCase("rescaled, no object", "deviations over no pixels", rescale=0.7, object_mask="empty"),
    LoopCase("β = 1", "edges weigh twice: more than all of the latents is replaced", beta=1.0),
    LoopCase(
        "β = 1, release",
        "the same at the step's own noise level, with fresh noise each step",
        beta=1.0,
        fidelity="release",
    ),
    LoopCase("no object", "guidance has nowhere to act", object_mask="empty"),
    LoopCase(
        "object everywhere", "guidance acts everywhere, no shadow is left", object_mask="full"
    ),
    LoopCase("object of one pixel", "its mask is 1/64 of one latent", object_mask="pixel"),
    LoopCase("object of one column", "thinner than a latent is wide", object_mask="column"),
    LoopCase("object half covered", "a mask that is nowhere 0 or 1", object_mask="checker"),
    LoopCase("object denormal", "covers 1e-40 of each pixel", object_mask="denormal"),
    LoopCase("shadow everywhere", "every latent is blended", shadow="full", object_mask="pixel"),
    LoopCase("no shadow", "nothing is blended, branches stay the same", shadow="empty"),
    LoopCase("no shadows", "both branches alike", shadow="empty", opposite="empty"),
    LoopCase(
        "shadow of one pixel",
        "downsampled to a quarter, binarised to a whole latent, all of it edge",
        object_mask="column",
        shadow="pixel",
    ),
    LoopCase(
        "shadow at the border", "erosion and dilation meet the end of the map", shadow="border"
    ),
    LoopCase("shadow under the object", "all of it is cut away again", shadow="disc"),
    LoopCase(
        "latents of 1e-40",
        "all numbers are denormal, few digits are left",
        scale=1e-40,
        composite_scale=1e-40,
    ),
    LoopCase("latents of 1e4", "tanh and int8 saturate; half would overflow squared", scale=1e4),
    LoopCase("composites of 1e4", "the blend outweighs the latents", composite_scale=1e4),
    LoopCase("one latent", "an 8×8 picture: every filter sees its border only", size=(1, 1)),
    LoopCase("5×3 latents", "odd sizes", size=(5, 3)),
    LoopCase("2×16 latents", "1:8", size=(2, 16)),
    LoopCase("256×256 latents", "a 2048×2048 picture", size=(256, 256), steps=2, full=True),
    LoopCase("seed 0", "falsy, and the least entropy there is", seed=0),
    LoopCase("seed 2⁶³ − 1", "the largest: one more overflows", seed=MAX_SEED),
)
"""Cases by name; the first of each family first."""
