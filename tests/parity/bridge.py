"""Between the runtime's float32 arrays (H, W, C) and the oracle's float64 tensors (C, H, W)."""

from __future__ import annotations

import numpy as np
import torch
from oracle import conditioning as method
from oracle.loop import Branch
from oracle.masks import guidance_mask, latent_shadow_mask
from oracle.networks import Backbone
from torch import Tensor

from spotlight_runtime import Intrinsics, LoopInputs, Scene
from spotlight_spec import BackboneSpec

__all__ = [
    "array",
    "background_of",
    "channel_order",
    "conditioning_of",
    "latent_size",
    "loop_inputs",
    "maps_of",
    "oracle_branch",
    "tensor",
]


def tensor(array: np.ndarray) -> Tensor:
    """(H, W) or (H, W, C) → float64 (C, H, W)."""
    return torch.from_numpy(np.atleast_3d(array).transpose(2, 0, 1).astype(np.float64))


def array(tensor: Tensor) -> np.ndarray:
    """(C, H, W) → (H, W, C), or (H, W) where C is 1."""
    values = tensor.permute(1, 2, 0).numpy()
    return values[..., 0] if values.shape[2] == 1 else values


def background_of(scene: Scene) -> Tensor:
    """The scene's background as the method means it: gamma-encoded."""
    return method.gamma_encoded(tensor(scene.background))


def maps_of(intrinsics: Intrinsics, alpha: Tensor | float) -> method.Maps:
    """A layer's maps, normals carried from [−1, 1] to [0, 1]; a background's alpha is 1."""
    rest = {
        name: None if getattr(intrinsics, name) is None else tensor(getattr(intrinsics, name))
        for name in ("albedo", "depth", "roughness", "metallic")
    }
    return method.Maps(normal=0.5 * tensor(intrinsics.normal) + 0.5 * alpha, **rest)


def channel_order(spec: BackboneSpec) -> tuple[str, ...]:
    """The spec's maps by ZeroComp's names."""
    return tuple("diffuse" if entry.name == "albedo" else entry.name for entry in spec.maps)


def latent_size(spec: BackboneSpec, scene: Scene) -> tuple[int, int]:
    """(h, w)."""
    return scene.size[0] // spec.latent.downscale, scene.size[1] // spec.latent.downscale


def conditioning_of(spec: BackboneSpec, scene: Scene, m_shw: Tensor) -> Tensor:
    """One branch's conditioning by the oracle; the scene has a footprint."""
    alpha = tensor(scene.object_mask)
    behind, in_front = maps_of(scene.background_maps, 1.0), maps_of(scene.object_maps, alpha)
    d_foot = tensor(scene.footprint_depth)
    aligned = method.aligned_to_footprint(in_front.depth, alpha, d_foot, d_foot > 0.0, behind.depth)
    region = method.masked_region(m_shw, alpha)
    if spec.shading.known == "inside":
        region = ~region
    return method.conditioning(
        channel_order(spec), background_of(scene), behind, in_front, alpha, aligned, region
    )


def oracle_branch(
    backbone: Backbone,
    spec: BackboneSpec,
    scene: Scene,
    shadow: np.ndarray,
    posterior_noise: Tensor | None,
) -> Branch:
    """A branch made by the oracle alone; without posterior noise E(g) is the posterior's mean."""
    alpha = tensor(scene.object_mask)
    m_shw = method.guiding_shadow(tensor(shadow), alpha)
    g = method.rough_composite(background_of(scene), tensor(scene.object_maps.albedo), alpha, m_shw)
    mean, deviation = backbone.posterior(method.for_encoder(g))
    z = mean if posterior_noise is None else mean + deviation * posterior_noise
    return Branch(
        conditioning=conditioning_of(spec, scene, m_shw),
        composite_latents=z * backbone.scale,
        shadow_mask=latent_shadow_mask(m_shw, alpha, latent_size(spec, scene)),
    )


def loop_inputs(
    branches: tuple[Branch, Branch],
    m_obj: Tensor,
    initial: Tensor,
    blends: list[Tensor],
    dtype: type,
) -> LoopInputs:
    """The oracle's arrays, rounded to the precision the runtime is to work in."""

    def stack(tensors: list[Tensor]) -> np.ndarray:
        return torch.stack(tensors).numpy().astype(dtype)

    return LoopInputs(
        conditioning=stack([branch.conditioning for branch in branches]),
        composite_latents=stack([branch.composite_latents for branch in branches]),
        shadow_mask=stack([branch.shadow_mask for branch in branches]),
        guidance_mask=stack([m_obj]),
        initial_noise=stack([initial]),
        step_noise=stack(blends),
    )


def object_on_latents(spec: BackboneSpec, scene: Scene) -> Tensor:
    """m_obj,↓ by the oracle."""
    return guidance_mask(tensor(scene.object_mask), latent_size(spec, scene))
