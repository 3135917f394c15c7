"""The passes of a relight, each on its own: guided by a shadow, without one, and to pictures.

A pass needs nothing another pass made but the arrays it is given, so a caller may leave one out,
share one between lights, or run them in another order, and none of the numbers change.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.conditioning import composite_maps, conditioning_array
from spotlight_runtime.diffusion.sampler import LoopInputs, Step, sample, shadow_guided
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import SolverName, make_solver
from spotlight_runtime.imaging.colour import decode_to_linear, encode_linear, linear_to_srgb
from spotlight_runtime.imaging.denoise import denoise, denoiser_available, require_denoiser
from spotlight_runtime.networks.codec import decode_latents, encode_conditioning
from spotlight_runtime.networks.models import predictor
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.planning.plan import GuidedPass, Plan
from spotlight_runtime.relighting.layers import Layer, frame_layer, window_layer
from spotlight_runtime.relighting.preparation import Prepared
from spotlight_runtime.relighting.putback import put_back
from spotlight_runtime.relighting.result import PassName, Progress, RelightResult, Stopwatch
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import BackboneSpec

__all__ = ["Task", "denoising", "develop", "guided_pass", "layer", "plain_pass", "result"]


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A relight made ready to run.

    Attributes
    ----------
    prepared : Prepared
    options : RelightOptions
        With nothing left to default.
    plan : Plan
        What is to be run.
    denoised : str
        ``on``, or why not.
    stopwatch : Stopwatch
    plain_key : str
        Names the picture without shadow, of this scene, seed and these steps.
    no_shadow : ndarray of float32, shape (h, w, 3), optional
        That picture, where it is known from before.
    """

    prepared: Prepared
    options: RelightOptions
    plan: Plan
    denoised: str
    stopwatch: Stopwatch
    plain_key: str
    no_shadow: FloatArray | None = None

    @property
    def lights(self) -> int:
        """How many lights there are."""
        return len(self.prepared.guides)

    def fresh(self) -> Task:
        """The same with a stopwatch of its own, for one more run."""
        return replace(self, stopwatch=Stopwatch(self.stopwatch.seconds))

    def only(self, number: int) -> Task:
        """The same with one of its lights."""
        plan = self.plan.only(number, first=number == 0)
        return replace(self, prepared=self.prepared.only(number), plan=plan)

    def drain(
        self, trajectory: Iterator[Step], stage: PassName, light: int, steps: int
    ) -> Generator[Progress, None, FloatArray]:
        """Yield progress of a pass and return its final latents; the caller's time is not counted.

        Parameters
        ----------
        trajectory : iterator of Step
        stage : {"relight", "no shadow"}
        light : int
            Which light the pass is for.
        steps : int
            How many it has.
        """
        while True:
            with self.stopwatch.stage(stage):
                step = next(trajectory)
            yield Progress(stage, step, steps, light, self.lights, self.prepared.window)
            if step.index == steps - 1:
                return step.latents


def guided_pass(
    networks: Mapping[str, Network],
    spec: BackboneSpec,
    inputs: LoopInputs,
    options: RelightOptions,
    planned: GuidedPass | None = None,
) -> Iterator[Step]:
    """SpotLight's loop on ready arrays (`shadow_guided`); draws no random number.

    Parameters
    ----------
    networks : mapping of str to Network
    spec : BackboneSpec
    inputs : LoopInputs
    options : RelightOptions
        ``gamma``, ``beta``, ``solver``, ``steps``, ``fidelity``, ``guidance_rescale`` and
        ``batch_branches`` apply.
    planned : GuidedPass, optional
        In which steps the branches are contrasted; by default in all of them.
    """
    predict = predictor(
        networks,
        encode_conditioning(networks, inputs.conditioning),
        spec.schedule,
        batch_branches=options.batch_branches,
    )
    return shadow_guided(
        predict,
        inputs,
        make_solver(options.solver, Schedule.trailing(spec.schedule, options.steps_for(spec))),
        gamma=options.gamma,
        beta=options.beta,
        guidance_rescale=options.guidance_rescale,
        fidelity=options.fidelity,
        branches=None if planned is None else planned.branches_at,
    )


def plain_pass(
    networks: Mapping[str, Network],
    spec: BackboneSpec,
    view: Scene,
    noise: FloatArray,
    solver: SolverName,
    steps: int,
) -> Iterator[Step]:
    """The renderer alone, with the shading hidden under the object only.

    Parameters
    ----------
    networks : mapping of str to Network
    spec : BackboneSpec
    view : Scene
        As `Prepared` has it.
    noise : ndarray of float32, shape (1, C, h, w)
        The guided pass's initial noise, so that what differs is the shadow.
    solver : str
    steps : int
    """
    conditioning = conditioning_array(spec, view, np.zeros_like(view.object_mask))
    predict = predictor(networks, encode_conditioning(networks, conditioning[None]), spec.schedule)
    return sample(predict, noise, make_solver(solver, Schedule.trailing(spec.schedule, steps)))


def denoising(spec: BackboneSpec, options: RelightOptions) -> str:
    """``on``, or why predictions are not denoised.

    Raises
    ------
    MissingExtraError
        If it is wanted and not installed.
    """
    if options.denoise is False:
        return "off: not wanted"
    if options.denoise:
        require_denoiser()
        return "on"
    if not spec.noisy_renders:
        return "off: the backbone was trained on clean renders"
    if not denoiser_available():
        return "off: Open Image Denoise is not installed (extra 'denoise')"
    return "on"


def develop(
    networks: Mapping[str, Network],
    spec: BackboneSpec,
    view: Scene,
    latents: FloatArray,
    denoised: bool,
    stopwatch: Stopwatch,
) -> FloatArray:
    """From the final latents of a pass, branch 0, to an encoded picture of the view's size."""
    with stopwatch.stage("decode"):
        encoded = decode_latents(networks, spec, latents[:1])
    if not denoised:
        return encoded
    with stopwatch.stage("denoise"):
        maps = composite_maps(view, tuple(n for n in ("albedo", "normal") if view.has_map(n)))
        linear = decode_to_linear(encoded, spec.image_encoding)
        clean = denoise(linear, maps.get("albedo"), maps.get("normal"))
        return encode_linear(clean, spec.image_encoding)


def layer(
    spec: BackboneSpec,
    prepared: Prepared,
    number: int,
    predicted: FloatArray,
    no_shadow: FloatArray,
    options: RelightOptions,
) -> Layer:
    """What one light's predictions make of the photograph.

    Parameters
    ----------
    spec : BackboneSpec
    prepared : Prepared
    number : int
        Which of its lights.
    predicted, no_shadow : ndarray of float32, shape (h, w, 3)
        As `develop` returns them.
    options : RelightOptions
        ``fidelity`` and ``detail`` apply.

    Returns
    -------
    Layer
    """
    shadow, _ = prepared.shadows[number]
    canvas, view = prepared.canvas, prepared.view
    fidelity = options.fidelity
    if prepared.window.native and options.detail != "maps":
        return frame_layer(spec, canvas.size, view, shadow, predicted, no_shadow, fidelity)
    return window_layer(
        spec,
        canvas,
        prepared.window,
        prepared.guides[number].positive,
        view,
        shadow,
        predicted,
        no_shadow,
        fidelity,
    )


def result(
    spec: BackboneSpec,
    task: Task,
    predicted: Sequence[FloatArray],
    no_shadow: FloatArray,
    model: dict[str, Any],
) -> RelightResult:
    """Put the predictions of all lights back into the photograph.

    Parameters
    ----------
    spec : BackboneSpec
    task : Task
    predicted : sequence of ndarray of float32, shape (h, w, 3)
        As `develop` returns them, one a light.
    no_shadow : ndarray of float32, shape (h, w, 3)
        Likewise, of the pass without shadow.
    model : dict
        Facts about the model.

    Returns
    -------
    RelightResult
    """
    prepared = task.prepared
    with task.stopwatch.stage("composite"):
        layers = [
            layer(spec, prepared, number, picture, no_shadow, task.options)
            for number, picture in enumerate(predicted)
        ]
        image = put_back(prepared.canvas, prepared.window, layers, prepared.mix)
    height, width = prepared.window.size

    def shown(linear: FloatArray) -> FloatArray:
        return linear_to_srgb(linear[:height, :width])

    lit = [decode_to_linear(picture, spec.image_encoding) for picture in predicted]
    return RelightResult(
        image=image,
        prediction=shown(prepared.mix.sum(lit)),
        no_shadow=shown(decode_to_linear(no_shadow, spec.image_encoding)),
        options=task.options,
        plan=task.plan,
        timings=dict(task.stopwatch.seconds),
        denoised=task.denoised,
        window=prepared.window,
        guides=prepared.guides,
        model=model,
    )
