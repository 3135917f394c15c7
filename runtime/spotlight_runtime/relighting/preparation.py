"""From a scene, its shadows and options to the arrays the loop runs on.

All randomness of a relight is drawn here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from spotlight_runtime.arrays import FloatArray, check_array, pad_edge
from spotlight_runtime.diffusion.blending import downsample_antialiased, latent_shadow_mask
from spotlight_runtime.diffusion.conditioning import KnownMaps, rough_composite
from spotlight_runtime.diffusion.noise import gaussian
from spotlight_runtime.diffusion.sampler import LoopInputs
from spotlight_runtime.networks.codec import encode_image
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.planning.options import RelightOptions, WindowMode
from spotlight_runtime.planning.plan import GuidedPass
from spotlight_runtime.planning.rules import LightFacts
from spotlight_runtime.relighting.canvas import Canvas
from spotlight_runtime.relighting.guides import GuidingShadow
from spotlight_runtime.relighting.mixing import Mix
from spotlight_runtime.relighting.window import Window, choose_window, look, shrink
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import BackboneSpec

__all__ = ["Prepared", "guidance_mask", "light_facts", "loop_inputs", "prepare", "prepare_window"]

Pair = tuple[FloatArray, FloatArray]

USUAL_ROUGHNESS: Final = np.float32(0.7)
"""Of rooms, streets and most things in them."""
DARKEST: Final = 0.02
"""Albedo below which its quotient says nothing about light."""


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """What is diffused, of a scene and the shadows of one or several lights.

    Attributes
    ----------
    canvas : Canvas
        The photograph.
    guides : tuple of GuidingShadow
        At the photograph's scale, one a light; the negative ones have served and are left out.
    mix : Mix
        How they combine.
    window : Window
        One for all lights, so that they can share the pass without shadow.
    view : Scene
        The window at the model's scale, its border grown to what the VAE takes.
    shadows : tuple of (ndarray, ndarray) of float32, shape of the view
        Positive and negative of each light, cleared under the object.
    """

    canvas: Canvas
    guides: tuple[GuidingShadow, ...]
    mix: Mix
    window: Window
    view: Scene
    shadows: tuple[Pair, ...]

    def latents(self, spec: BackboneSpec) -> int:
        """Height × width of what is diffused, at latent size."""
        height, width = self.view.size
        return (height // spec.latent.downscale) * (width // spec.latent.downscale)

    def only(self, number: int) -> Prepared:
        """The same with one of its lights."""
        guide = self.guides[number]
        return replace(self, guides=(guide,), mix=Mix.of([guide]), shadows=(self.shadows[number],))


def prepare_window(
    spec: BackboneSpec, scene: Scene, guides: Sequence[GuidingShadow], mode: WindowMode = "auto"
) -> Prepared:
    """Choose the window, and bring the scene and all shadows to the model's scale.

    Parameters
    ----------
    spec : BackboneSpec
    scene : Scene
    guides : sequence of GuidingShadow
        Checked against the scene.
    mode : {"auto", "frame"}

    Returns
    -------
    Prepared

    Raises
    ------
    InvalidInputError
        If in some channel no light gives anything.
    """
    drawn = [s for guide in guides for s in (guide.positive, guide.negative) if s is not None]
    window = choose_window(spec.size, spec.latent.downscale, scene.object_mask, drawn, mode)
    small = _with_usual_light(spec, _with_usual_materials(look(scene, window)))

    def pair(guide: GuidingShadow) -> tuple[Scene, Pair]:
        negative = guide.negative
        return prepare(
            spec,
            small,
            _seen_shadow(guide.positive, scene, window),
            None if negative is None else _seen_shadow(negative, scene, window),
        )

    prepared = [pair(guide) for guide in guides]
    return Prepared(
        canvas=Canvas.of(scene),
        guides=tuple(replace(guide, negative=None) for guide in guides),
        mix=Mix.of(guides),
        window=window,
        view=prepared[0][0],
        shadows=tuple(shadows for _, shadows in prepared),
    )


def prepare(
    spec: BackboneSpec, scene: Scene, shadow: FloatArray, negative: FloatArray | None
) -> tuple[Scene, Pair]:
    """Bring scene and shadows to a size the VAE takes, and clear the shadows under the object.

    Parameters
    ----------
    spec : BackboneSpec
    scene : Scene
    shadow : ndarray of float32, shape (H, W)
        Guiding shadow in [0, 1].
    negative : ndarray of float32, shape (H, W), or None
        Shadow of the negative branch; None: no shadow.

    Returns
    -------
    scene : Scene
        Grown to multiples of the latent downscale by repeating its border.
    shadows : tuple of two ndarray of float32, shape of the grown scene
        Positive and negative, times (1 − object mask).

    Raises
    ------
    InvalidInputError
        If a shadow does not fit the scene or its range.
    """
    opposite = np.zeros_like(shadow) if negative is None else negative
    check_array(shadow, "shadow", scene.size, None, (0.0, 1.0))
    check_array(opposite, "negative", scene.size, None, (0.0, 1.0))
    padded = scene.padded(spec.latent.downscale)

    def cleared(mask: FloatArray) -> FloatArray:
        return np.clip(pad_edge(mask, padded.size), 0.0, 1.0) * (1.0 - padded.object_mask)

    return padded, (cleared(shadow), cleared(opposite))


def loop_inputs(
    networks: Mapping[str, Network],
    spec: BackboneSpec,
    scene: Scene,
    shadows: Pair,
    options: RelightOptions,
    planned: GuidedPass,
    known: KnownMaps,
) -> LoopInputs:
    """Everything `shadow_guided` needs for the branches that are planned.

    Parameters
    ----------
    networks : mapping of str to Network
        ``vae_encoder`` is used.
    spec : BackboneSpec
    scene : Scene
        As `prepare` returns it.
    shadows : tuple of two ndarray of float32, shape (H, W)
        As `prepare` returns them, positive first.
    options : RelightOptions
    planned : GuidedPass
        How many branches there are, and which of them blend their composite in.
    known : KnownMaps
        Of the scene.

    Returns
    -------
    LoopInputs
    """
    branches = shadows[: planned.branches]
    latent = spec.latent
    shape = (latent.channels, *(side // latent.downscale for side in scene.size))
    release = options.fidelity == "release"
    deviation = np.float32(latent.start_deviation)
    noise = step_noise = deviation * gaussian(options.seed, "initial", (1, *shape))
    blends = range(options.steps_for(spec) - 1)
    if release and blends:
        fresh = [gaussian(options.seed, "step", shape, index) for index in blends]
        step_noise = deviation * np.stack(fresh)
    if latent.start_mean:
        noise = noise + np.asarray(latent.start_mean, dtype=np.float32)[:, None, None]

    def encode(branch: int, shadow: FloatArray) -> FloatArray:
        if not planned.encoded[branch]:
            return np.zeros((1, *shape), np.float32)
        sampled = gaussian(options.seed, "posterior", (1, *shape), branch) if release else None
        composite = rough_composite(spec, scene, shadow, options.shadow_opacity)
        return encode_image(networks, spec, composite, sampled)

    return LoopInputs(
        conditioning=np.stack([known.hiding(shadow) for shadow in branches]),
        composite_latents=np.concatenate([encode(i, s) for i, s in enumerate(branches)]),
        shadow_mask=np.stack([_blend_mask(spec, scene, shadow)[None] for shadow in branches]),
        guidance_mask=guidance_mask(spec, scene)[None, None],
        initial_noise=noise,
        step_noise=step_noise,
    )


def light_facts(spec: BackboneSpec, scene: Scene, shadows: Pair) -> LightFacts:
    """What a plan needs to know of one light's shadows, as `prepare` returns them."""
    positive, negative = shadows
    return LightFacts(
        shadow=bool(positive.any()),
        blendable=(
            bool(_blend_mask(spec, scene, positive).any()),
            bool(_blend_mask(spec, scene, negative).any()),
        ),
        contrast=not np.array_equal(positive, negative),
    )


def _blend_mask(spec: BackboneSpec, scene: Scene, shadow: FloatArray) -> FloatArray:
    return latent_shadow_mask(shadow, scene.object_mask, spec.latent.downscale)


def guidance_mask(spec: BackboneSpec, scene: Scene) -> FloatArray:
    """Object mask at latent size, antialiased; float32 of shape (h, w)."""
    return downsample_antialiased(scene.object_mask, spec.latent.downscale)


def _with_usual_materials(view: Scene) -> Scene:
    """The scene, where it does not say what things are made of, of matt ones that are no metal.

    So scenes of the published test set, most of which come without these maps of their background,
    can be shown to a backbone that asks for them.
    """
    filled = []
    for maps, cover in (
        (view.background_maps, np.ones_like(view.object_mask)),
        (view.object_maps, view.object_mask),
    ):
        usual = {"roughness": USUAL_ROUGHNESS * cover, "metallic": np.zeros_like(cover)}
        missing = {name: value for name, value in usual.items() if getattr(maps, name) is None}
        filled.append(replace(maps, **missing) if missing else maps)
    return replace(view, background_maps=filled[0], object_maps=filled[1])


def _with_usual_light(spec: BackboneSpec, view: Scene) -> Scene:
    """The scene, where the scale of its albedo is unknown, with one that leaves the usual light.

    A renderer trained on true albedo takes bright estimates for dim light: real photographs with
    albedo of mean 0.4 gave its objects half of their light (`ShadingSpec.usual_light`).
    """
    usual = spec.shading.usual_light
    if not usual or view.albedo_scale == "known":
        return view
    maps = view.background_maps
    seen, reflected = (each.mean(axis=2) for each in (view.background, maps.albedo))
    told = reflected > DARKEST
    if not told.any() or not seen[told].any():
        return view
    factor = np.float32(np.median(seen[told] / reflected[told]) / usual)
    return replace(
        view, background_maps=replace(maps, albedo=np.clip(factor * maps.albedo, 0.0, 1.0))
    )


def _seen_shadow(shadow: FloatArray, scene: Scene, window: Window) -> FloatArray:
    """The window's part of a shadow at the model's scale: the mean of what is to be seen of it."""
    if window.native:
        return shadow
    visible = np.float32(1.0) - window.crop(scene.object_mask)
    small = shrink(np.clip(window.crop(shadow), 0.0, 1.0) * visible, window.size)
    share = shrink(visible, window.size)
    return np.clip(np.divide(small, share, out=np.zeros_like(small), where=share > 0.0), 0.0, 1.0)
