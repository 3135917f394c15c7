"""A tiny backbone of numpy functions that commutes with mirroring the picture."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spotlight_spec import BackboneSpec

__all__ = ["channels_of", "equivariant_networks"]

Array = np.ndarray
WIDTHS = {"normal": 3, "diffuse": 3, "albedo": 3, "shading": 3}


def channels_of(spec: BackboneSpec, name: str) -> slice:
    """Where a map lies among the conditioning channels."""
    start = 0
    for entry in spec.maps:
        width = WIDTHS.get(entry.name, 1)
        if entry.name == name:
            return slice(start, start + width)
        start += width
    raise KeyError(name)


def equivariant_networks(
    spec: BackboneSpec, seed: int = 0, blind_to: str | None = None
) -> dict[str, Callable[..., dict[str, Array]]]:
    """The four graphs as functions: means over patches, mixed by random weights, blurred evenly.

    A mirrored picture gives mirrored latents: patches are weighed evenly, the blur is symmetric,
    and of the normals only the size of each component counts, since mirroring turns one's sign.

    Parameters
    ----------
    spec : BackboneSpec
    seed : int
    blind_to : str, optional
        A map that is not looked at, and with ``shading`` neither is the rough composite.
    """
    rng = np.random.default_rng(seed)
    side, latent = spec.latent.downscale, spec.latent.channels
    hidden = 6

    def weights(out: int, into: int) -> Array:
        return rng.normal(0.0, into**-0.5, (out, into)).astype(np.float32)

    into_latent = 3.0 * weights(2 * latent, 3)
    into_condition = weights(hidden, spec.conditioning_channels)
    into_hidden, out_of_hidden = weights(12, latent + hidden), weights(latent, 12)
    into_picture = 0.4 * weights(3, latent)
    normal = channels_of(spec, "normal")
    unseen = None if blind_to is None else channels_of(spec, blind_to)

    def encoder(image: Array) -> dict[str, Array]:
        seen = np.zeros_like(image) if blind_to == "shading" else image
        mean, log_std = np.split(_mixed(into_latent, _patches(seen, side)), 2, axis=1)
        return {"latent_mean": mean, "latent_std": np.exp(np.tanh(log_std))}

    def condition(conditioning: Array) -> dict[str, Array]:
        seen = conditioning.copy()
        seen[:, normal] = np.abs(seen[:, normal] - np.float32(0.5))
        if unseen is not None:
            seen[:, unseen] = 0.0
        return {"condition": np.tanh(_mixed(into_condition, _patches(np.tanh(seen), side)))}

    def denoiser(latents: Array, timestep: Array, condition: Array) -> dict[str, Array]:
        both = _blurred(np.concatenate([latents, condition], axis=1))
        bias = np.float32(1e-3) * timestep.astype(np.float32)
        return {"prediction": _mixed(out_of_hidden, np.tanh(_mixed(into_hidden, both) + bias))}

    def decoder(latents: Array) -> dict[str, Array]:
        small = np.tanh(_mixed(into_picture, latents))
        return {"image": small.repeat(side, axis=2).repeat(side, axis=3)}

    return {
        "vae_encoder": encoder,
        "condition_encoder": condition,
        "denoiser": denoiser,
        "vae_decoder": decoder,
    }


def _mixed(weights: Array, planes: Array) -> Array:
    """A 1×1 convolution of planes (N, C, h, w)."""
    return np.einsum("oc,nchw->nohw", weights, planes, optimize=True).astype(np.float32)


def _patches(planes: Array, side: int) -> Array:
    """Means over squares, summed in float64 so that the order does not show."""
    n, c, height, width = planes.shape
    split = planes.reshape(n, c, height // side, side, width // side, side).astype(np.float64)
    return split.mean(axis=(3, 5)).astype(np.float32)


def _blurred(planes: Array) -> Array:
    """A 3×3 blur with even weights, the border repeated."""
    for axis in (2, 3):
        grow = [(0, 0)] * 4
        grow[axis] = (1, 1)
        wide = np.moveaxis(np.pad(planes, grow, mode="edge"), axis, 0)
        sides = np.float32(0.25) * (wide[:-2] + wide[2:])
        planes = np.moveaxis(sides + np.float32(0.5) * wide[1:-1], 0, axis)
    return planes
