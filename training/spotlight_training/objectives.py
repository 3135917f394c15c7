"""What each network is trained to do, and the sheets that show how well it does it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from spotlight_runtime.diffusion.sampler import sample
from spotlight_runtime.diffusion.schedule import Schedule, alphas_cumprod
from spotlight_runtime.diffusion.solvers import make_solver
from spotlight_spec import BackboneSpec
from spotlight_training.networks import VAE, ConditionEncoder, Denoiser
from spotlight_training.networks.occlusion import as_normals, directions

__all__ = [
    "Renderer",
    "intrinsics_loss",
    "intrinsics_sheet",
    "renderer_loss",
    "renderer_sheet",
    "vae_loss",
    "vae_sheet",
]

Batch = dict[str, Tensor]
Loss = Callable[[nn.Module, Batch, torch.Generator], dict[str, Tensor]]
Sheet = Callable[[nn.Module, Path], None]

GRADIENT_WEIGHT = 1.0
SHADOW_WEIGHT = 2.0
OBJECT_WEIGHT = 1.0
LIGHT_WEIGHT = 0.01
SHARPNESS = 20.0
"""Of the distribution of directions that the renderer's guess of the light is taught."""
PERTURBATION = 0.15
"""Share of the noise by which latents are noisier than the renderer is told. Its own steps leave
such noise behind, and one that believes it paints objects mottled (Ning et al. 2023)."""


class Renderer(nn.Module):
    """Condition encoder and denoiser, trained together over a frozen VAE."""

    def __init__(self, vae: VAE, condition: ConditionEncoder, denoiser: Denoiser) -> None:
        super().__init__()
        self.vae, self.condition, self.denoiser = vae.requires_grad_(False), condition, denoiser


def vae_loss(model: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
    """L1 of pixels and of their differences, decoding posterior samples.

    The posterior is given, so there is no divergence to weigh against them.
    """
    assert isinstance(model, VAE)
    image = batch["image"]
    mean, log_variance = model.encode(image)
    noise = torch.randn(mean.shape, generator=generator, device=mean.device)
    decoded = model.decode(mean + torch.exp(0.5 * log_variance) * noise).float()
    return {
        "l1": functional.l1_loss(decoded, image),
        "gradient": GRADIENT_WEIGHT * _gradient_distance(decoded, image),
    }


def renderer_loss(spec: BackboneSpec) -> Loss:
    """Squared error of v over uniformly drawn timesteps, with zero terminal SNR.

    Channels count by the square root of their share in the picture: the first components of a
    patch are its light, the last hardly visible texture. Timesteps count by σ, half way between
    an error of v and one of x₀: nearly clean latents have little left to decide.
    """
    alpha_bar = torch.from_numpy(alphas_cumprod(spec.schedule)).float()

    def loss(model: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        assert isinstance(model, Renderer)
        device = batch["image"].device
        with torch.no_grad():
            x0 = model.vae.encode(batch["image"])[0].float() * spec.latent.scaling_factor
        t = torch.randint(
            0, len(alpha_bar), (len(x0),), generator=generator, device=device, dtype=torch.int64
        )
        noise = torch.randn(x0.shape, generator=generator, device=device)
        level = alpha_bar.to(device)[t][:, None, None, None]
        more = torch.randn(x0.shape, generator=generator, device=device)
        noisy = level.sqrt() * x0 + (1 - level).sqrt() * (noise + PERTURBATION * more)
        target = level.sqrt() * noise - (1 - level).sqrt() * x0
        condition = model.condition(batch["conditioning"])
        v, _, found = model.denoiser.explained(noisy, t, condition)
        shares = model.vae.synthesis[0].weight.float().square().sum(dim=(0, 2, 3)).sqrt().sqrt()
        error = (level.sub(1).neg().sqrt() * (v.float() - target).square()).mean(dim=(0, 2, 3))
        size = found.shadow.shape[-2:]
        shadow, cover = (
            functional.adaptive_avg_pool2d(batch[name], size) for name in ("shadow", "object_mask")
        )
        likely = coming_from(batch["lamps"])
        return {
            "v": (shares / shares.mean() * error).mean(),
            "shadow": SHADOW_WEIGHT * functional.mse_loss(found.shadow, shadow),
            "object": OBJECT_WEIGHT * functional.mse_loss(found.object_mask, cover),
            "light": LIGHT_WEIGHT * functional.kl_div(found.likely, likely, reduction="batchmean"),
        }

    return loss


def coming_from(lamps: Tensor) -> Tensor:
    """Distribution (B, D) over candidate directions of light from lamps (B, L, 4).

    Those are directions in the normals' frame and shares; see `Picture`.
    """
    towards = as_normals(directions().to(lamps))
    near = functional.softmax(SHARPNESS * (lamps[..., :3] @ towards.T), dim=2)
    return (lamps[..., 3:] * near).sum(dim=1)


def intrinsics_loss(
    model: nn.Module, batch: Batch, generator: torch.Generator
) -> dict[str, Tensor]:
    """L1 of albedo, angle of normals, scale-invariant log depth (Eigen et al. 2014)."""
    predicted = model(batch["image"]).float()
    albedo, normal, depth = predicted[:, :3], predicted[:, 3:6], predicted[:, 6:]
    error = torch.log(depth) - torch.log(batch["depth"].clamp_min(1e-2))
    shift = error.mean(dim=(1, 2, 3), keepdim=True)
    return {
        "albedo": functional.l1_loss(albedo, batch["albedo"])
        + _gradient_distance(albedo, batch["albedo"]),
        "normal": 1 - (normal * batch["normal"]).sum(dim=1).mean(),
        "depth": (error - 0.85 * shift).abs().mean() + _gradient_distance(error, error * 0),
    }


def vae_sheet(samples: list[dict[str, Any]], device: str) -> Sheet:
    """Held-out images above their reconstructions, with the PSNR of each."""

    def sheet(model: nn.Module, path: Path) -> None:
        assert isinstance(model, VAE)
        columns = []
        for item in samples:
            image = torch.from_numpy(item["image"])[None].to(device)
            with torch.no_grad():
                decoded = model.decode(model.encode(image)[0]).clamp(-1, 1)
            psnr = -10 * torch.log10(((decoded - image) / 2).square().mean()).item()
            columns.append([_label(_pixels(image), ""), _label(_pixels(decoded), f"{psnr:.1f} dB")])
        _write_sheet(path, columns)

    return sheet


def renderer_sheet(samples: list[dict[str, Any]], spec: BackboneSpec, device: str) -> Sheet:
    """Held-out truth, hidden shading and what the renderer makes of it, in 10 steps."""

    def sheet(model: nn.Module, path: Path) -> None:
        assert isinstance(model, Renderer)
        columns = []
        for number, item in enumerate(samples):
            conditioning = torch.from_numpy(item["conditioning"])[None].to(device)
            image = torch.from_numpy(item["image"])[None].to(device)
            decoded = render(model, spec, conditioning, seed=number)
            shading = conditioning[:, spec.channels["shading"]].clamp(0, 2) - 1
            psnr = -10 * torch.log10(((decoded - image) / 2).square().mean()).item()
            columns.append(
                [
                    _label(_pixels(image), ""),
                    _label(_pixels(shading), ""),
                    _label(_pixels(decoded), f"{psnr:.1f} dB"),
                ]
            )
        _write_sheet(path, columns)

    return sheet


@torch.no_grad()
def render(
    model: Renderer, spec: BackboneSpec, conditioning: Tensor, seed: int, steps: int = 10
) -> Tensor:
    """Run the renderer with the runtime's own sampler; image (1, 3, H, W) in [−1, 1]."""
    device = conditioning.device
    condition = model.condition(conditioning)

    def predict(z: npt.NDArray[Any], t: int) -> npt.NDArray[Any]:
        latents = torch.from_numpy(z).to(device)
        v = model.denoiser(latents, torch.tensor([t], device=device), condition)
        return v.float().cpu().numpy()

    shape = (1, spec.latent.channels, *(s // spec.latent.downscale for s in conditioning.shape[2:]))
    noise = np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)
    solver = make_solver("ddim", Schedule.trailing(spec.schedule, steps))
    z = noise
    for step in sample(predict, noise, solver):
        z = step.latents
    latents = torch.from_numpy(z).to(device) / spec.latent.scaling_factor
    return model.vae.decode(latents).float().clamp(-1, 1)


def intrinsics_sheet(samples: list[dict[str, Any]], device: str) -> Sheet:
    """Held-out photograph, then truth and estimate of albedo, normals and depth."""

    def sheet(model: nn.Module, path: Path) -> None:
        columns = []
        for item in samples:
            image = torch.from_numpy(item["image"])[None].to(device)
            with torch.no_grad():
                predicted = model(image).float()
            truth = torch.from_numpy(np.concatenate([item["albedo"], item["normal"]]))[None]
            rows = [_pixels(2 * image - 1)]
            for maps, depth in (
                (truth, torch.from_numpy(item["depth"])[None]),
                (predicted.cpu(), predicted[:, 6:].cpu()),
            ):
                nearness = 2 * depth.amin() / depth - 1
                rows += [_pixels(2 * maps[:, :3] - 1), _pixels(maps[:, 3:6])]
                rows.append(_pixels(nearness.expand(-1, 3, -1, -1)))
            columns.append(rows)
        _write_sheet(path, columns)

    return sheet


def _gradient_distance(a: Tensor, b: Tensor) -> Tensor:
    """L1 between horizontal and vertical differences."""
    error = a - b
    return (error[..., 1:, :] - error[..., :-1, :]).abs().mean() + (
        error[..., 1:] - error[..., :-1]
    ).abs().mean()


def _pixels(image: Tensor) -> npt.NDArray[np.uint8]:
    unit = (image[0].clamp(-1, 1) * 0.5 + 0.5).permute(1, 2, 0).cpu().numpy()
    return np.round(unit[..., ::-1] * 255).astype(np.uint8)


def _label(pixels: npt.NDArray[np.uint8], text: str) -> npt.NDArray[np.uint8]:
    pixels = np.ascontiguousarray(pixels)
    cv2.putText(pixels, text, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3)
    cv2.putText(pixels, text, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1)
    return pixels


def _write_sheet(path: Path, columns: list[list[npt.NDArray[np.uint8]]]) -> None:
    cv2.imwrite(str(path), np.hstack([np.vstack(rows) for rows in columns]))
