"""From a scene and a guiding shadow to the relit picture.

`Relighter` owns the networks and nothing else; every stage is a pure function of another module::

    scene ─► loop inputs ─► shadow_guided ─► decode ─► denoise ─► compose ─► RelightResult
                       └──► no-shadow pass ──┘
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.codec import decode_latents, encode_conditioning
from spotlight_runtime.colour import decode_to_linear, encode_linear, linear_to_srgb
from spotlight_runtime.composite import compose_picture
from spotlight_runtime.conditioning import composite_maps, conditioning_array, masked_region
from spotlight_runtime.denoise import denoise, denoiser_available, require_denoiser
from spotlight_runtime.models import LazyNetworks, open_networks, predictor, resolve_model
from spotlight_runtime.options import RelightOptions
from spotlight_runtime.preparation import loop_inputs, prepare
from spotlight_runtime.result import PassName, Progress, RelightResult, Stopwatch
from spotlight_runtime.sampler import LoopInputs, Step, sample, shadow_guided
from spotlight_runtime.scene import Scene
from spotlight_runtime.schedule import Schedule
from spotlight_runtime.sessions import DEFAULT_PROVIDERS, Network
from spotlight_runtime.solvers import make_solver
from spotlight_spec import BackboneSpec

__all__ = ["Relighter"]


class Relighter:
    """A backbone ready to relight.

    Parameters
    ----------
    spec : BackboneSpec
        What the networks are.
    networks : mapping of str to callable
        By graph name; see `spotlight_runtime.sessions.Network`. Plain functions do.
    low_memory : bool
        Close each session once its stage is over.
    model : dict, optional
        Facts about the model for reports.
    """

    def __init__(
        self,
        spec: BackboneSpec,
        networks: Mapping[str, Network],
        *,
        low_memory: bool = False,
        model: dict[str, Any] | None = None,
    ) -> None:
        self.spec = spec
        self._networks = networks
        self._low_memory = low_memory
        self._model = model or {}

    @classmethod
    def load(
        cls,
        model: str | Path = "mini",
        *,
        providers: Sequence[str] = DEFAULT_PROVIDERS,
        threads: int | None = None,
        low_memory: bool = False,
        verify_files: bool = True,
    ) -> Relighter:
        """Load a model by name or folder.

        Parameters
        ----------
        model : str or Path
            A name that ``spotlight models`` lists, or a folder.
        providers : sequence of str
            ONNX Runtime execution providers; the first must be the one in use.
        threads : int, optional
            Threads of one inference; by default the CPUs this process may use.
        low_memory : bool
            Hold only the session of the stage at work.
        verify_files : bool
            Check every file against the manifest's sha256 first.

        Raises
        ------
        ModelError
            If the model is unknown, damaged, or cannot run on the provider.
        """
        folder = resolve_model(model)
        networks = open_networks(
            folder, providers=providers, threads=threads, verify_files=verify_files
        )
        return cls(
            folder.manifest.backbone, networks, low_memory=low_memory, model=folder.summary()
        )

    def relight(
        self,
        scene: Scene,
        shadow: FloatArray,
        negative: FloatArray | None = None,
        options: RelightOptions | None = None,
    ) -> RelightResult:
        """Relight the object of a scene by its shadow.

        Parameters
        ----------
        scene : Scene
        shadow : ndarray of float32, shape (H, W)
            Guiding shadow in [0, 1], 1 = fully shadowed. What lies under the object is ignored.
        negative : ndarray of float32, shape (H, W), optional
            Shadow of the negative branch: the light opposite, or another drawing. None: no shadow.
        options : RelightOptions, optional

        Returns
        -------
        RelightResult

        Raises
        ------
        InvalidInputError
            If a shadow or option is out of its domain.
        MissingMapError
            If the scene lacks a map the backbone needs.
        NumericalError
            If a network's output is not finite; the message names stage and step.
        """
        run = self.run(scene, shadow, negative, options)
        while True:
            try:
                next(run)
            except StopIteration as stop:
                result: RelightResult = stop.value
                return result

    def run(
        self,
        scene: Scene,
        shadow: FloatArray,
        negative: FloatArray | None = None,
        options: RelightOptions | None = None,
    ) -> Generator[Progress, None, RelightResult]:
        """Do as `relight`, as a generator that yields after each step and returns the result.

        Close it to cancel between two steps.
        """
        options = options or RelightOptions()
        denoising = self._denoising(options)  # an error about it now, not after the loop
        stopwatch = Stopwatch()
        with stopwatch.stage("prepare"):
            padded, shadows = prepare(self.spec, scene, shadow, negative)
        with stopwatch.stage("encode"):
            inputs = loop_inputs(self._networks, self.spec, padded, shadows, options)
            self._release("vae_encoder")
        steps = options.steps_for(self.spec)
        with stopwatch.stage("condition"):
            guided = self.trajectory(inputs, options)
        latents = yield from _drain(guided, "relight", stopwatch, steps)
        with stopwatch.stage("condition"):
            plain = self._without_shadow(padded, inputs.initial_noise, options)
        plain_latents = yield from _drain(plain, "no shadow", stopwatch, steps)
        self._release("condition_encoder", "denoiser", "controlnet", "unet")

        with stopwatch.stage("decode"):
            predicted = decode_latents(self._networks, self.spec, latents[:1])
            no_shadow = decode_latents(self._networks, self.spec, plain_latents)
            self._release("vae_decoder")
        if denoising == "on":
            with stopwatch.stage("denoise"):
                predicted = self._denoise(predicted, padded)
                no_shadow = self._denoise(no_shadow, padded)
        with stopwatch.stage("composite"):
            image = self._compose(padded, shadows[0], predicted, no_shadow, options)
        crop = np.s_[: scene.size[0], : scene.size[1]]
        return RelightResult(
            image=image[crop],
            prediction=self._to_srgb(predicted)[crop],
            no_shadow=self._to_srgb(no_shadow)[crop],
            options=replace(options, steps=steps),
            evaluations=steps * (len(shadows) + 1),
            timings=stopwatch.seconds,
            denoised=denoising,
            model=self._model,
        )

    def loop_inputs(
        self,
        scene: Scene,
        shadow: FloatArray,
        negative: FloatArray | None = None,
        options: RelightOptions | None = None,
    ) -> LoopInputs:
        """The arrays `relight` runs its loop on, to inspect, save or replay elsewhere."""
        options = options or RelightOptions()
        padded, shadows = prepare(self.spec, scene, shadow, negative)
        return loop_inputs(self._networks, self.spec, padded, shadows, options)

    def trajectory(
        self, inputs: LoopInputs, options: RelightOptions | None = None
    ) -> Iterator[Step]:
        """Run SpotLight's loop on ready arrays, yielding the latents step by step.

        No random number is drawn and nothing is derived from a scene: with another
        implementation's arrays this replays its trajectory. Of the options, gamma, beta, steps,
        solver, fidelity (noise level of the blend), guidance_rescale and batch_branches apply.
        """
        options = options or RelightOptions()
        predict = predictor(
            self._networks,
            encode_conditioning(self._networks, inputs.conditioning),
            self.spec.schedule,
            batch_branches=options.batch_branches,
        )
        return shadow_guided(
            predict,
            inputs,
            make_solver(options.solver, self._schedule(options)),
            gamma=options.gamma,
            beta=options.beta,
            guidance_rescale=options.guidance_rescale,
            fidelity=options.fidelity,
        )

    def _schedule(self, options: RelightOptions) -> Schedule:
        return Schedule.trailing(self.spec.schedule, options.steps_for(self.spec))

    def _without_shadow(
        self, scene: Scene, noise: FloatArray, options: RelightOptions
    ) -> Iterator[Step]:
        """The renderer alone: same noise, shading hidden under the object only."""
        conditioning = conditioning_array(self.spec, scene, np.zeros_like(scene.object_mask))
        condition = encode_conditioning(self._networks, conditioning[None])
        predict = predictor(self._networks, condition, self.spec.schedule)
        return sample(predict, noise, make_solver(options.solver, self._schedule(options)))

    def _denoising(self, options: RelightOptions) -> str:
        if options.denoise is False:
            return "off: not wanted"
        if options.denoise:
            require_denoiser()
            return "on"
        if not self.spec.noisy_renders:
            return "off: the backbone was trained on clean renders"
        if not denoiser_available():
            return "off: Open Image Denoise is not installed (extra 'denoise')"
        return "on"

    def _denoise(self, encoded: FloatArray, scene: Scene) -> FloatArray:
        maps = composite_maps(scene, tuple(n for n in ("albedo", "normal") if scene.has_map(n)))
        linear = decode_to_linear(encoded, self.spec.image_encoding)
        clean = denoise(linear, maps.get("albedo"), maps.get("normal"))
        return encode_linear(clean, self.spec.image_encoding)

    def _compose(
        self,
        scene: Scene,
        shadow: FloatArray,
        predicted: FloatArray,
        no_shadow: FloatArray,
        options: RelightOptions,
    ) -> FloatArray:
        background = np.clip(encode_linear(scene.background, self.spec.image_encoding), 0.0, 1.0)
        region = masked_region(shadow, scene.object_mask)
        composed, untouched = compose_picture(
            background,
            predicted,
            no_shadow,
            scene.object_mask,
            region if options.fidelity == "paper" else None,
        )
        # Going through the backbone's encoding and back rounds; what is untouched stays exact.
        kept = linear_to_srgb(scene.background)
        return np.where(untouched[..., None], kept, self._to_srgb(composed))

    def _to_srgb(self, encoded: FloatArray) -> FloatArray:
        return linear_to_srgb(decode_to_linear(encoded, self.spec.image_encoding))

    def _release(self, *names: str) -> None:
        if self._low_memory and isinstance(self._networks, LazyNetworks):
            self._networks.release(*names)


def _drain(
    trajectory: Iterator[Step], stage: PassName, stopwatch: Stopwatch, steps: int
) -> Generator[Progress, None, FloatArray]:
    """Yield progress of a pass and return its final latents; the caller's time is not counted."""
    while True:
        with stopwatch.stage(stage):
            step = next(trajectory)
        yield Progress(stage, step, steps)
        if step.index == steps - 1:
            return step.latents
