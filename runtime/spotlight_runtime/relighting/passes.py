"""The passes of a relight, each on its own: guided by a shadow, without one, and to a picture.

A pass needs nothing another pass made but the arrays it is given, so a caller may leave one out,
share one between lights, or run them in another order, and none of the numbers change.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.diffusion.conditioning import KnownMaps, composite_maps
from spotlight_runtime.diffusion.sampler import LoopInputs, Step, sample, shadow_guided
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import SolverName, make_solver
from spotlight_runtime.imaging.colour import decode_to_linear, encode_linear
from spotlight_runtime.imaging.denoise import denoise, denoiser_available, require_denoiser
from spotlight_runtime.networks.codec import decode_latents, encode_conditioning
from spotlight_runtime.networks.models import predictor
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.planning.plan import GuidedPass
from spotlight_runtime.relighting.result import Stopwatch
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import BackboneSpec

__all__ = ["denoising", "develop", "guided_pass", "plain_pass"]


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
        In which steps the branches are contrasted, and in which deep features are reused; by
        default in all of them, and in none.
    """
    predict = predictor(
        networks,
        encode_conditioning(networks, inputs.conditioning),
        spec.schedule,
        batch_branches=options.batched_for(spec),
        reuse=1 if planned is None else planned.reuse,
    )
    steps = options.steps_for(spec)
    return shadow_guided(
        predict,
        inputs,
        make_solver(options.solver, Schedule.trailing(spec.schedule, steps)),
        gamma=options.gamma,
        beta=options.weight_of_steps(steps, spec.schedule.steps),
        guidance_rescale=options.guidance_rescale,
        fidelity=options.fidelity,
        branches=None if planned is None else planned.branches_at,
    )


def plain_pass(
    networks: Mapping[str, Network],
    spec: BackboneSpec,
    known: KnownMaps,
    noise: FloatArray,
    solver: SolverName,
    steps: int,
    reuse: int = 1,
) -> Iterator[Step]:
    """The renderer alone, with the shading hidden under the object only.

    Parameters
    ----------
    networks : mapping of str to Network
    spec : BackboneSpec
    known : KnownMaps
        Of the view.
    noise : ndarray of float32, shape (1, C, h, w)
        The guided pass's initial noise, so that what differs is the shadow.
    solver : str
    steps : int
    reuse : int
        As `GuidedPass` has it.
    """
    conditioning = known.hiding(np.zeros_like(known.object_mask))
    encoded = encode_conditioning(networks, conditioning[None])
    predict = predictor(networks, encoded, spec.schedule, reuse=reuse)
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
