"""The same run three ways: by the oracle, by the runtime, and by a loop around diffusers' DDIM."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from diffusers import DDIMScheduler
from oracle.loop import Branch, Draws, Fidelity, Knobs, spotlight
from oracle.networks import Backbone
from oracle.schedule import scaled_linear_alpha_bar, trailing_timesteps, zero_terminal_snr

from spotlight_runtime import Relighter, RelightOptions, Scene
from spotlight_spec import BackboneSpec

from .bridge import loop_inputs, object_on_latents, oracle_branch
from .shadows import NEGATIVES, Negative, wanted_shadow

__all__ = ["STEPS", "Run", "Trajectories"]

STEPS = 20


@dataclass(frozen=True)
class Run:
    """One point of the grid."""

    knobs: Knobs
    negative: Negative


class Trajectories:
    """Both branches' latents (2, 4, h, w) after every step, each run computed once.

    Every way of running starts from the oracle's own float64 arrays, made from the scene, rounded
    to the precision that way works in.
    """

    def __init__(
        self,
        spec: BackboneSpec,
        scene: Scene,
        backbone64: Backbone,
        backbone32: Backbone,
        relighter_over: Callable[[str], Relighter],
    ) -> None:
        self._spec, self._scene = spec, scene
        self._backbone64, self._backbone32 = backbone64, backbone32
        self._relighter_over = relighter_over
        random = torch.Generator().manual_seed(469)
        draws = [torch.randn((4, 8, 12), generator=random).double() for _ in range(STEPS + 2)]
        self._draws, self._posterior = Draws(draws[0], draws[3:]), draws[1:3]
        self._m_obj = object_on_latents(spec, scene)
        self.oracle = cache(self._oracle)
        self.runtime = cache(self._runtime)
        self._branches = cache(self._make_branches)

    def _oracle(self, run: Run) -> list[np.ndarray]:
        """Float64 throughout."""
        alpha_bar = zero_terminal_snr(scaled_linear_alpha_bar())
        history = spotlight(
            self._backbone64.predict,
            *self._branches(run.negative, run.knobs.fidelity),
            self._m_obj,
            self._draws,
            trailing_timesteps(STEPS),
            alpha_bar,
            alpha_bar[0],
            run.knobs,
        )
        return [torch.stack(pair).numpy() for pair in history]

    def _runtime(self, networks: str, run: Run) -> list[np.ndarray]:
        """`Relighter.trajectory`, the documented replay."""
        inputs = loop_inputs(
            self._branches(run.negative, run.knobs.fidelity),
            self._m_obj,
            self._draws.initial,
            self._draws.blends if run.knobs.fidelity == "release" else [self._draws.initial],
            np.float64 if networks == "float64" else np.float32,
        )
        options = RelightOptions(
            gamma=run.knobs.gamma,
            beta=run.knobs.beta,
            fidelity=run.knobs.fidelity,
            guidance_rescale=run.knobs.phi,
            steps=STEPS,
        )
        relighter = self._relighter_over(networks)
        return [step.latents for step in relighter.trajectory(inputs, options)]

    def diffusers(self, run: Run) -> list[np.ndarray]:
        """Float32, stepped and noised by diffusers' own scheduler as its pipelines do."""
        scheduler = DDIMScheduler(
            beta_start=0.00085,
            beta_end=0.012,
            beta_schedule="scaled_linear",
            prediction_type="v_prediction",
            timestep_spacing="trailing",
            rescale_betas_zero_snr=True,
            set_alpha_to_one=False,
            clip_sample=False,
        )
        scheduler.set_timesteps(STEPS)
        branches = self._branches(run.negative, run.knobs.fidelity)
        composite = torch.stack([branch.composite_latents for branch in branches]).float()
        weight = run.knobs.beta * torch.stack([branch.shadow_mask for branch in branches]).float()
        conditioning = torch.stack([branch.conditioning for branch in branches]).float()
        release = run.knobs.fidelity == "release"
        m, z = self._m_obj.float(), torch.stack([self._draws.initial] * 2).float()
        history = []
        for i, t in enumerate(scheduler.timesteps):
            v_pos, v_neg = self._backbone32.evaluate(z, int(t), conditioning)
            v = (1.0 - m) * v_pos + m * (v_neg + run.knobs.gamma * (v_pos - v_neg))
            z = scheduler.step(v[None], t, z).prev_sample
            if i < STEPS - 1:
                epsilon = self._draws.blends[i] if release else self._draws.initial
                level = t if release else scheduler.timesteps[i + 1]
                noised = scheduler.add_noise(composite, epsilon.float()[None], level[None])
                z = (1.0 - weight) * z + weight * noised
            history.append(z.numpy())
        return history

    def _make_branches(self, negative: Negative, fidelity: Fidelity) -> tuple[Branch, Branch]:
        """Positive and negative; the release samples the posterior, the paper takes its mean."""
        shadows = (wanted_shadow(self._scene), NEGATIVES[negative](self._scene))
        noise = self._posterior if fidelity == "release" else [None, None]
        positive, opposite = (
            oracle_branch(self._backbone64, self._spec, self._scene, shadow, epsilon)
            for shadow, epsilon in zip(shadows, noise)
        )
        return positive, opposite
