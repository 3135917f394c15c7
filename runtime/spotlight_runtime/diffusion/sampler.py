"""The denoising loop, and what SpotLight adds to it.

`sample` is the loop of any diffusion renderer: a generator that yields after each step. Close it to
cancel; progress bars, previews and server events are what a caller does between steps. It knows one
meaning of the network, ``v = predict(latents, timestep)``.

`shadow_guided` is SpotLight: the same loop over two branches that share their noise, with masked
guidance and shadow blending; of several lights at once, where a call costs less for being shared.
It takes ready arrays (`LoopInputs`) and draws no random number, so
another implementation's trajectory can be replayed and compared number for number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from spotlight_runtime.arrays import FloatArray, require_finite
from spotlight_runtime.diffusion.blending import add_noise, blend_shadow
from spotlight_runtime.diffusion.guidance import masked_guidance, rescale_guidance
from spotlight_runtime.diffusion.solvers import Solver
from spotlight_runtime.errors import NumericalError, ShapeError

__all__ = ["Fidelity", "LoopInputs", "Predict", "Step", "sample", "shadow_guided"]

SMALLER: Final = "the prediction is finite but too large: lower gamma, or use another model"
"""What helps where arithmetic overflows, not a network."""
Fidelity = Literal["paper", "release"]
Predict = Callable[[FloatArray, int], FloatArray]
"""``predict(latents (branches, C, h, w), timestep) -> v`` of the same shape. Asked for fewer
branches than there are, it is asked for the first ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """State after one denoising step.

    Attributes
    ----------
    index : int
        Step number from 0.
    timestep : int
        Train timestep the network was asked at.
    latents : ndarray of float32, shape (branches, C, h, w)
        Latents after the step (and, but for the last step, after blending); positive first.
    denoised : ndarray of float32, shape (branches, C, h, w)
        x0 predicted at this step: decode it for a preview.
    """

    index: int
    timestep: int
    latents: FloatArray
    denoised: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LoopInputs:
    """Everything a shadow-guided run needs, as arrays.

    Attributes
    ----------
    conditioning : ndarray of float32, shape (branches, K, H, W)
        Conditioning maps: the positive branch of each light, then the negative of each; no more
        branches than lights means no guidance.
    composite_latents : ndarray of float32, shape (branches, C, h, w)
        Scaled latents Z of the rough composites (posterior mean or sample).
    shadow_mask : ndarray of float32, shape (branches, 1, h, w)
        `latent_shadow_mask` of each branch, before β.
    guidance_mask : ndarray of float32, shape (1, 1, h, w)
        Object mask at latent size, antialiased.
    initial_noise : ndarray of float32, shape (1, C, h, w)
        Starting latents, shared by the branches.
    step_noise : ndarray of float32, shape (steps − 1, C, h, w) or (1, C, h, w)
        Noise of each blend, shared by the branches; one array serves all steps.
    lights : int
        How many lights the branches are of.
    """

    conditioning: FloatArray
    composite_latents: FloatArray
    shadow_mask: FloatArray
    guidance_mask: FloatArray
    initial_noise: FloatArray
    step_noise: FloatArray
    lights: int = 1

    def __post_init__(self) -> None:
        branches = self.conditioning.shape[0]
        latent = self.initial_noise.shape[1:]
        expected = {
            "composite_latents": (branches, *latent),
            "shadow_mask": (branches, 1, *latent[1:]),
            "guidance_mask": (1, 1, *latent[1:]),
            "initial_noise": (1, *latent),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ShapeError(f"{name}: expected {shape}, got {getattr(self, name).shape}")
        if branches not in (self.lights, 2 * self.lights):
            raise ShapeError(f"conditioning: expected 1 or 2 branches a light, got {branches}")
        if self.step_noise.shape[1:] != latent:
            raise ShapeError(f"step_noise: expected (n, *{latent}), got {self.step_noise.shape}")

    @classmethod
    def joined(cls, lights: Sequence[LoopInputs]) -> LoopInputs:
        """Those of several lights as one, for lights that share guidance mask and noise."""
        first, branches = lights[0], range(len(lights[0].conditioning))

        def stacked(name: str) -> FloatArray:
            return np.stack([getattr(each, name)[i] for i in branches for each in lights])

        arrays = {n: stacked(n) for n in ("conditioning", "composite_latents", "shadow_mask")}
        return replace(first, **arrays, lights=len(lights))


def sample(
    predict: Predict,
    latents: FloatArray,
    solver: Solver,
    combine: Callable[[FloatArray], FloatArray] | None = None,
    blend: Callable[[int, FloatArray], FloatArray] | None = None,
    branches: Callable[[int], int] | None = None,
) -> Iterator[Step]:
    """Denoise, one yield a step.

    Parameters
    ----------
    predict : callable
        The network as a v-prediction.
    latents : ndarray of float32, shape (branches, C, h, w)
        Where to start: unit Gaussian noise.
    solver : Solver
        A fresh solver; its schedule sets the steps.
    combine : callable, optional
        Makes of the predictions of the branches that were evaluated what steps them all.
    blend : callable, optional
        ``blend(index, latents)`` after every step but the last: what is blended last could no
        longer be refined.
    branches : callable, optional
        ``branches(index)`` → how many are evaluated at a step.

    Yields
    ------
    Step

    Raises
    ------
    NumericalError
        If a prediction or the latents are not finite, naming the step; also what ``predict``
        raises, with the step in front.
    """
    last = len(solver.schedule) - 1
    for index, timestep in enumerate(solver.schedule.timesteps.tolist()):
        where = f"step {index} (timestep {timestep})"
        try:
            v = predict(latents if branches is None else latents[: branches(index)], timestep)
        except NumericalError as error:
            raise NumericalError(f"{where}: {error}") from error
        require_finite(v, f"{where}: the network's prediction")
        with np.errstate(over="ignore", invalid="ignore"):  # an error below, not a warning first
            if combine is not None:
                v = combine(v)
                require_finite(v, f"{where}: the guided prediction", SMALLER)
            latents, denoised = solver.step(index, latents, v)
            if blend is not None and index < last:
                latents = blend(index, latents)
        require_finite(latents, f"{where}: the latents", SMALLER)
        yield Step(index, timestep, latents, denoised)


def shadow_guided(
    predict: Predict,
    inputs: LoopInputs,
    solver: Solver,
    *,
    gamma: float = 3.0,
    beta: float = 0.05,
    guidance_rescale: float = 0.0,
    fidelity: Fidelity = "paper",
    branches: Callable[[int], int] | None = None,
) -> Iterator[Step]:
    """SpotLight's loop (paper §3, eq. 1 and 2).

    Parameters
    ----------
    predict : callable
        Network of all branches; see `Predict`.
    inputs : LoopInputs
        Ready arrays.
    solver : Solver
        A fresh solver.
    gamma : float
        Guidance scale γ; unused with one branch.
    beta : float
        Shadow latent weight β.
    guidance_rescale : float
        φ of `rescale_guidance`.
    fidelity : {"paper", "release"}
        Noise level of the blend: that of the latents it is blended into (paper, eq. 1), or of the
        step's own t, one level noisier (the public release).
    branches : callable, optional
        ``branches(index)`` → 2 where a light's branches are contrasted, 1 where the negative one is
        left out; by default they always are.

    Yields
    ------
    Step
    """
    count, lights = inputs.conditioning.shape[0], inputs.lights
    blends = len(solver.schedule) - 1
    if beta > 0.0 and len(inputs.step_noise) not in (1, blends) and blends > 0:
        raise ShapeError(
            f"step_noise: expected 1 or {blends} arrays for {blends + 1} steps, "
            f"got {len(inputs.step_noise)}"
        )
    latents = np.repeat(inputs.initial_noise, count, axis=0)

    def combine(v: FloatArray) -> FloatArray:
        positive, negative, mask = v[:lights], v[lights:], inputs.guidance_mask
        if len(negative):
            guided = masked_guidance(positive, negative, mask, gamma)
            pairs = zip(np.split(guided, lights), np.split(positive, lights))
            each = [rescale_guidance(g, p, mask, guidance_rescale) for g, p in pairs]
            positive = np.concatenate(each)
        return np.concatenate([positive, positive])

    def blend(index: int, z: FloatArray) -> FloatArray:
        level = index if fidelity == "release" else index + 1
        noise = inputs.step_noise[min(index, len(inputs.step_noise) - 1)]
        noised = add_noise(inputs.composite_latents, noise, float(solver.schedule.alpha_bar[level]))
        return blend_shadow(z, noised, inputs.shadow_mask, beta)

    return sample(
        predict,
        latents,
        solver,
        combine if count > lights else None,
        blend if beta > 0.0 and inputs.shadow_mask.any() else None,
        None if branches is None else lambda index: lights * branches(index),
    )
