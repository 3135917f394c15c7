"""Between pictures and latents: the networks that run once a branch, not once a step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spotlight_runtime.arrays import FloatArray, require_finite
from spotlight_runtime.networks.sessions import Network
from spotlight_spec import BackboneSpec

__all__ = ["decode_latents", "encode_conditioning", "encode_image"]


def encode_image(
    networks: Mapping[str, Network],
    spec: BackboneSpec,
    encoded: FloatArray,
    posterior_noise: FloatArray | None = None,
) -> FloatArray:
    """Scaled latents ``E(image)·s`` of an image.

    Parameters
    ----------
    networks : mapping of str to Network
    spec : BackboneSpec
    encoded : ndarray of float32, shape (H, W, 3)
        In [0, 1], encoded as the backbone's images are.
    posterior_noise : ndarray of float32, shape (1, C, h, w), optional
        Sample the posterior with it; without it, take the mean.

    Returns
    -------
    ndarray of float32, shape (1, C, h, w)
    """
    pixels = (np.float32(2.0) * encoded - np.float32(1.0)).transpose(2, 0, 1)[None]
    posterior = networks["vae_encoder"](image=np.ascontiguousarray(pixels))
    z = posterior["latent_mean"]
    require_finite(z, "encoding the rough composite")
    with np.errstate(over="ignore", invalid="ignore"):  # an error below, not a warning first
        if posterior_noise is not None:
            require_finite(posterior["latent_std"], "encoding the rough composite (its deviation)")
            z = z + posterior["latent_std"] * posterior_noise
        z = z * np.float32(spec.latent.scaling_factor)
    require_finite(z, "scaling the rough composite's latents")
    return z


def encode_conditioning(networks: Mapping[str, Network], conditioning: FloatArray) -> FloatArray:
    """Encoded condition of each branch, shape (branches, E, h, w).

    One branch at a time: activations at full resolution are the largest of all.
    """
    encoder = networks["condition_encoder"]
    each = [encoder(conditioning=branch[None])["condition"] for branch in conditioning]
    for branch, condition in enumerate(each):
        require_finite(condition, f"encoding the conditioning (branch {branch})")
    return np.concatenate(each)


def decode_latents(
    networks: Mapping[str, Network], spec: BackboneSpec, latents: FloatArray
) -> FloatArray:
    """``D(z/s)`` of latents of shape (1, C, h, w): encoded image (H, W, 3), clipped to [0, 1]."""
    with np.errstate(over="ignore"):
        z = latents / np.float32(spec.latent.scaling_factor)
    require_finite(z, "unscaling the latents")
    image = networks["vae_decoder"](latents=z)["image"][0]
    require_finite(image, "decoding the latents")
    pixels = np.clip(image * np.float32(0.5) + np.float32(0.5), 0.0, 1.0)
    return np.ascontiguousarray(pixels.transpose(1, 2, 0))
