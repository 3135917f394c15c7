"""From a scene, its shadows and options to the arrays the loop runs on.

All randomness of a relight is drawn here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spotlight_runtime.arrays import FloatArray, check_array, pad_edge
from spotlight_runtime.blending import downsample_antialiased, latent_shadow_mask
from spotlight_runtime.codec import encode_image
from spotlight_runtime.conditioning import conditioning_array, rough_composite
from spotlight_runtime.noise import gaussian
from spotlight_runtime.options import RelightOptions
from spotlight_runtime.sampler import LoopInputs
from spotlight_runtime.scene import Scene
from spotlight_runtime.sessions import Network
from spotlight_spec import BackboneSpec

__all__ = ["loop_inputs", "prepare"]


def prepare(
    spec: BackboneSpec, scene: Scene, shadow: FloatArray, negative: FloatArray | None
) -> tuple[Scene, tuple[FloatArray, FloatArray]]:
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
    shadows: tuple[FloatArray, ...],
    options: RelightOptions,
) -> LoopInputs:
    """Everything `shadow_guided` needs, one branch a shadow.

    Parameters
    ----------
    networks : mapping of str to Network
        ``vae_encoder`` is used.
    spec : BackboneSpec
    scene : Scene
        As `prepare` returns it.
    shadows : tuple of ndarray of float32, shape (H, W)
        As `prepare` returns them, positive first.
    options : RelightOptions

    Returns
    -------
    LoopInputs
    """
    latent = spec.latent
    shape = (latent.channels, *(side // latent.downscale for side in scene.size))
    release = options.fidelity == "release"
    noise = step_noise = gaussian(options.seed, "initial", (1, *shape))
    blends = range(options.steps_for(spec) - 1)
    if release and blends:
        fresh = [gaussian(options.seed, "step", shape, index) for index in blends]
        step_noise = np.stack(fresh)

    def encode(branch: int, shadow: FloatArray) -> FloatArray:
        sampled = gaussian(options.seed, "posterior", (1, *shape), branch) if release else None
        composite = rough_composite(spec, scene, shadow, options.shadow_opacity)
        return encode_image(networks, spec, composite, sampled)

    def mask(shadow: FloatArray) -> FloatArray:
        return latent_shadow_mask(shadow, scene.object_mask, latent.downscale)[None]

    return LoopInputs(
        conditioning=np.stack([conditioning_array(spec, scene, shadow) for shadow in shadows]),
        composite_latents=np.concatenate([encode(i, s) for i, s in enumerate(shadows)]),
        shadow_mask=np.stack([mask(shadow) for shadow in shadows]),
        guidance_mask=downsample_antialiased(scene.object_mask, latent.downscale)[None, None],
        initial_noise=noise,
        step_noise=step_noise,
    )
