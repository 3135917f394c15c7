"""From a scene and its light to the relit picture.

`Relighter` owns networks and caches and nothing else; every stage is a pure function elsewhere::

    scene, lights ─► guiding shadows ─► window ─► plan ─► guided pass, one a light ────────┐
                                                    └───► pass without shadow ─────────────┤
                          RelightResult ◄─ put back ◄─ layers ◄─ develop (decode, denoise) ◄┘
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.conditioning import KnownMaps
from spotlight_runtime.diffusion.sampler import LoopInputs, Step
from spotlight_runtime.errors import ModelError
from spotlight_runtime.imaging.colour import decode_to_linear, linear_to_srgb
from spotlight_runtime.networks.codec import decode_latents
from spotlight_runtime.networks.models import Engine, open_networks, release, resolve_model
from spotlight_runtime.networks.sessions import DEFAULT_PROVIDERS, EVERY_STEP, Network
from spotlight_runtime.planning.costs import (
    Costs,
    Pace,
    Seconds,
    cache_path,
    outdated,
    read_costs,
    write_costs,
)
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.planning.plan import Plan
from spotlight_runtime.relighting import passes
from spotlight_runtime.relighting.calibration import measure_costs
from spotlight_runtime.relighting.finishing import result
from spotlight_runtime.relighting.guides import Guide, Negative
from spotlight_runtime.relighting.preparation import loop_inputs
from spotlight_runtime.relighting.remembered import CAPACITY, Remembered
from spotlight_runtime.relighting.result import Progress, RelightResult, Stopwatch
from spotlight_runtime.relighting.tasks import Task, Wishes, prepare_task
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import BackboneSpec

__all__ = ["Relighter"]


class Relighter:
    """A backbone ready to relight.

    Parameters
    ----------
    spec : BackboneSpec
        What the networks are.
    networks : mapping of str to callable
        By graph name; see `spotlight_runtime.networks.sessions.Network`. Plain functions do.
    low_memory : bool
        Close each session once its stage is over.
    model : dict, optional
        Facts about the model for reports.
    remember : int
        Bytes of pictures without shadow to keep for further lights of a scene; 0: none.
    costs_file : Path, optional
        Where it is kept what the stages cost on this machine.

    Attributes
    ----------
    costs : Costs or None
        What the stages cost, as measured; None where they were not yet. Predictions follow what
        relights took since (`spotlight_runtime.planning.costs.Pace`).

    Raises
    ------
    ModelError
        If the backbone is for relighting the picture around an object, not an object in it.
    """

    def __init__(
        self,
        spec: BackboneSpec,
        networks: Mapping[str, Network],
        *,
        low_memory: bool = False,
        model: dict[str, Any] | None = None,
        remember: int = CAPACITY,
        costs_file: Path | None = None,
    ) -> None:
        if spec.shading.known == "inside":
            raise ModelError(
                f"{spec.name}: expected a backbone that is told the shading around object and "
                "shadow, got one that is told theirs alone: it relights the rest of the picture "
                "after them. To relight an object use another, say zerocomp-openrooms or mini"
            )
        self.spec = spec
        self._networks = networks
        self._low_memory = low_memory
        self._model = model or {}
        self._remembered = Remembered(remember)
        self._costs_file = costs_file
        self.costs = None if costs_file is None else read_costs(costs_file)
        self._outdated = costs_file is not None and outdated(costs_file)
        self._pace = Pace()

    @classmethod
    def load(
        cls,
        model: str | Path = "mini",
        *,
        engine: Engine = "onnxruntime",
        providers: Sequence[str] = DEFAULT_PROVIDERS,
        threads: int | None = None,
        low_memory: bool = False,
        verify_files: bool = True,
        remember: int = CAPACITY,
    ) -> Relighter:
        """Load a model by name or folder.

        Parameters
        ----------
        model : str or Path
            A name that ``spotlight models`` lists, or a folder.
        engine : {"onnxruntime", "openvino", "openvino-bf16"}
            What computes the graphs. OpenVINO is an extra of its own, float32 or bfloat16, and
            pays for full-size models on processors that multiply bfloat16.
        providers : sequence of str
            ONNX Runtime's execution providers; the first must be the one in use.
        threads : int, optional
            Threads of one inference; by default the CPUs this process may use.
        low_memory : bool
            Hold only the session of the stage at work.
        verify_files : bool
            Check every file against the manifest's sha256 first.
        remember : int
            Bytes of pictures without shadow to keep for further lights of a scene; 0: none.

        Raises
        ------
        ModelError
            If the model is unknown, damaged, or cannot run on the provider.
        InvalidInputError
            If there is no such engine, no provider is named, or ``threads`` is less than 1.
        """
        folder = resolve_model(model)
        networks = open_networks(
            folder, engine=engine, providers=providers, threads=threads, verify_files=verify_files
        )
        facts = folder.summary() | {"engine": engine}
        run_on = (facts["fingerprint"], facts["precision"], engine, *providers)
        return cls(
            folder.manifest.backbone,
            networks,
            low_memory=low_memory,
            model=facts,
            remember=remember,
            costs_file=cache_path(" ".join(run_on), threads),
        )

    def relight(
        self,
        scene: Scene,
        light: Guide | Sequence[Guide],
        negative: Negative | None = None,
        options: RelightOptions | None = None,
        **changes: Unpack[Wishes],
    ) -> RelightResult:
        """Relight the object of a scene.

        Parameters
        ----------
        scene : Scene
        light : Light, or ndarray of float32 of shape (H, W), or a sequence of them
            A light, whose guiding shadow is cast; or a ready guiding shadow in [0, 1], 1 = fully
            shadowed. What lies under the object is ignored. Several lights make one picture, each
            with its weight and colour (`spotlight_runtime.relighting.mixing`); for ready shadows
            these are given as `GuidingShadow`. Lights without weight or colour are left out, as
            long as there are others.
        negative : Light, ndarray of float32 of shape (H, W), "opposite" or "none", optional
            What the guidance contrasts with. By default the light opposite; of a ready shadow, no
            shadow, and of a light whose opposite would be in the object, likewise.
        options : RelightOptions, optional
        **changes
            Single options by name: ``gamma=3.0, seed=469``; a named ``plan`` or a ``budget`` in
            seconds that they start from (`spotlight_runtime.relighting.tasks.Wishes`).

        Raises
        ------
        InvalidInputError
            If a light, shadow or option is out of its domain.
        BudgetError
            If no plan fits the budget.
        MissingMapError
            If the scene lacks a map the backbone needs.
        NumericalError
            If a network's output is not finite; the message names stage and step.
        """
        run = self.run(scene, light, negative, options, **changes)
        while True:
            try:
                next(run)
            except StopIteration as stop:
                result: RelightResult = stop.value
                return result

    def relight_each(
        self,
        scene: Scene,
        lights: Sequence[Guide],
        negative: Negative | None = None,
        options: RelightOptions | None = None,
        **changes: Unpack[Wishes],
    ) -> list[RelightResult]:
        """Relight under each light alone: one picture a light, of one window and seed.

        They share the pass without shadow. Parameters and errors are those of `relight`.
        """
        made = self.run_each(scene, lights, negative, options, **changes)
        return [each for each in made if isinstance(each, RelightResult)]

    def run(
        self,
        scene: Scene,
        light: Guide | Sequence[Guide],
        negative: Negative | None = None,
        options: RelightOptions | None = None,
        **changes: Unpack[Wishes],
    ) -> Generator[Progress, None, RelightResult]:
        """Do as `relight`, yielding after each step, returning the result; close it to cancel."""
        task = self.prepare(scene, light, negative, options, mixed=True, **changes)
        return (yield from self.start(task))

    def run_each(
        self,
        scene: Scene,
        lights: Sequence[Guide],
        negative: Negative | None = None,
        options: RelightOptions | None = None,
        **changes: Unpack[Wishes],
    ) -> Generator[Progress | RelightResult, None, None]:
        """Do as `relight_each`, yielding progress and, as each picture is done, its result."""
        yield from self.start_each(self.prepare(scene, lights, negative, options, **changes))

    def prepare(
        self,
        scene: Scene,
        light: Guide | Sequence[Guide],
        negative: Negative | None = None,
        options: RelightOptions | None = None,
        *,
        mixed: bool = False,
        **changes: Unpack[Wishes],
    ) -> Task:
        """Cast shadows, choose the window and bring everything to the model's scale.

        What comes out is all that is needed; who lets go of the scene here has a relight of a
        12-megapixel photograph in half the memory. Parameters and errors are those of `relight`;
        what is ``mixed`` is for `start` alone and leaves out lights without weight or colour.
        """
        return prepare_task(
            self.spec,
            scene,
            light,
            negative,
            options,
            changes,
            self._remembered,
            self._costs_for,
            self._reusable,
            mixed=mixed,
        )

    def plan(
        self,
        scene: Scene,
        light: Guide | Sequence[Guide],
        negative: Negative | None = None,
        options: RelightOptions | None = None,
        **changes: Unpack[Wishes],
    ) -> Plan:
        """What `relight` would do, why, and how long it would take; no picture is made.

        Parameters and errors are those of `relight`.
        """
        self.calibrated()
        return self.prepare(scene, light, negative, options, mixed=True, **changes).plan

    def calibrated(self, *, again: bool = False) -> Costs:
        """What the stages cost on this machine; measured in two seconds where it is not known.

        What was measured over an hour ago is measured again, once: virtual machines do not stay as
        quick as they were.

        Parameters
        ----------
        again : bool
            Measure, whatever is known.
        """
        if self.costs is None or self._outdated or again:
            self._outdated = False
            measured = Relighter(self.spec, self._networks, remember=0)
            self.costs = measure_costs(
                self.spec,
                lambda scene, shadow, options: measured.relight(scene, shadow, options=options),
                reusable=self._reusable,
            )
            self._pace = Pace()
            if self._costs_file is not None:
                write_costs(self._costs_file, self.costs)
        return self.costs

    def start(self, task: Task) -> Generator[Progress, None, RelightResult]:
        """`run`, of what `prepare` made."""
        task = task.fresh()
        with task.stopwatch.stage("encode"):
            known = KnownMaps.of(self.spec, task.prepared.view)
            inputs = [self._inputs(task, number, known) for number in range(task.lights)]
            self._release("vae_encoder")
        latents = []
        for lights in task.plan.together:
            latents += yield from self._guided(task, lights, inputs[lights.start : lights.stop])
        plain = yield from self._plain(task, known, inputs[0].initial_noise)
        self._release("condition_encoder", *EVERY_STEP)
        predicted = [self._develop(task, z) for z in latents]
        no_shadow = self._no_shadow(task, plain, predicted[0])
        self._release("vae_decoder")
        made = result(self.spec, task, predicted, no_shadow, self._model)
        self._learn(task, made.timings)
        return made

    def start_each(self, task: Task) -> Generator[Progress | RelightResult, None, None]:
        """`run_each`, of what `prepare` made."""
        task = task.fresh()
        no_shadow: FloatArray | None = None
        with task.stopwatch.stage("encode"):
            known = KnownMaps.of(self.spec, task.prepared.view)
        for lights in task.plan.together:
            group = task.timed_by(Stopwatch())
            with group.stopwatch.stage("encode"):
                inputs = [self._inputs(task, number, known) for number in lights]
            latents = yield from self._guided(group, lights, inputs)
            for number, each in zip(lights, latents):
                alone = task.only(number)
                alone.stopwatch.charge(group.stopwatch.seconds, len(lights))
                predicted = self._develop(alone, each)
                if no_shadow is None:
                    # Progress is told as of all lights, and timed as of this one.
                    shared = task.timed_by(alone.stopwatch)
                    plain = yield from self._plain(shared, known, inputs[0].initial_noise)
                    no_shadow = self._no_shadow(shared, plain, predicted)
                yield result(self.spec, alone, [predicted], no_shadow, self._model)
        self._release("vae_encoder", "condition_encoder", *EVERY_STEP, "vae_decoder")

    def preview_of(self, progress: Progress) -> FloatArray:
        """What the renderer thinks the picture will be, at a step of a pass.

        Parameters
        ----------
        progress : Progress
            As `run` yields it.

        Returns
        -------
        ndarray of float32, shape (h, w, 3)
            What is in ``progress.window``, at the model's scale; sRGB-encoded, in [0, 1].
        """
        encoded = decode_latents(self._networks, self.spec, progress.step.denoised[:1])
        height, width = progress.window.size
        linear = decode_to_linear(encoded[:height, :width], self.spec.image_encoding)
        return linear_to_srgb(linear)

    def loop_inputs(
        self,
        scene: Scene,
        light: Guide,
        negative: Negative | None = None,
        options: RelightOptions | None = None,
        **changes: Unpack[Wishes],
    ) -> LoopInputs:
        """The arrays `relight` runs its loop on, to inspect, save or replay elsewhere."""
        changes["skip"] = False  # all there is, whether or not a relight calls for it
        task = self.prepare(scene, light, negative, options, **changes)
        return self._inputs(task, 0, KnownMaps.of(self.spec, task.prepared.view))

    def trajectory(
        self, inputs: LoopInputs, options: RelightOptions | None = None
    ) -> Iterator[Step]:
        """Run SpotLight's loop on ready arrays, yielding the latents step by step.

        No random number is drawn and nothing is derived from a scene: with another
        implementation's arrays this replays its trajectory. Of the options, gamma, beta, steps,
        solver, fidelity (noise level of the blend), guidance_rescale and batch_branches apply.
        """
        return passes.guided_pass(self._networks, self.spec, inputs, options or RelightOptions())

    @property
    def _reusable(self) -> bool:
        return "denoiser_shallow" in self._networks

    def _costs_for(self, needed: bool) -> Costs | None:
        costs = self.calibrated() if needed else self.costs
        return None if costs is None else self._pace.of(costs)

    def _learn(self, task: Task, timings: Mapping[str, float]) -> None:
        """Let predictions follow what a relight took."""
        plan, total = task.plan, task.plan.seconds
        if self.costs is None or total is None:
            return
        latents, whole = task.prepared.latents(self.spec), plan.evaluations - plan.shallow
        costs = self._pace.of(self.costs)
        predicted = costs.evaluations(latents, whole, plan.shallow, plan.passes_run)
        took = timings["relight"] + timings.get("no shadow", 0.0)
        over = timings["prepare"]
        self._pace.learn(
            Seconds(predicted, total - predicted - over),
            Seconds(took, sum(timings.values()) - took - over),
        )

    def _inputs(self, task: Task, number: int, known: KnownMaps) -> LoopInputs:
        view, shadows = task.prepared.view, task.prepared.shadows[number]
        planned = task.plan.passes[number]
        return loop_inputs(self._networks, self.spec, view, shadows, task.options, planned, known)

    def _guided(
        self, task: Task, lights: range, inputs: Sequence[LoopInputs]
    ) -> Generator[Progress, None, list[FloatArray]]:
        """Final latents (1, C, h, w) of each of the lights."""
        planned = task.plan.passes[lights.start]
        with task.stopwatch.stage("condition"):
            trajectory = passes.guided_pass(
                self._networks, self.spec, LoopInputs.joined(inputs), task.options, planned
            )
        latents = yield from task.drain(trajectory, "relight", lights, planned.steps)
        return np.split(latents[: len(lights)], len(lights))

    def _plain(
        self, task: Task, known: KnownMaps, noise: FloatArray
    ) -> Generator[Progress, None, FloatArray | None]:
        planned = task.plan.plain
        if planned.source != "run":
            return None
        solver = task.options.solver
        with task.stopwatch.stage("condition"):
            trajectory = passes.plain_pass(
                self._networks, self.spec, known, noise, solver, planned.steps, planned.reuse
            )
        return (yield from task.drain(trajectory, "no shadow", range(1), planned.steps))

    def _no_shadow(self, task: Task, plain: FloatArray | None, relit: FloatArray) -> FloatArray:
        """The picture without shadow, from wherever the plan has it; remembered from now on."""
        if task.no_shadow is not None:
            return task.no_shadow
        picture = relit if plain is None else self._develop(task, plain)
        self._remembered.put(task.plain_key, picture)
        return picture

    def _develop(self, task: Task, latents: FloatArray) -> FloatArray:
        denoised, view = task.denoised == "on", task.prepared.view
        return passes.develop(self._networks, self.spec, view, latents, denoised, task.stopwatch)

    def _release(self, *names: str) -> None:
        if self._low_memory:
            release(self._networks, *names)
