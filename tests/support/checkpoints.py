"""Random-weight checkpoints in the layout diffusers publishes, tiny and full-size.

Nothing here is a model anyone would use: the weights are seeded noise. What matters is that the
files, names and configurations are exactly those of a published checkpoint, and that ControlNet's
zero convolutions are *not* zero, so that a test notices when its residuals go astray.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from diffusers import AutoencoderKL, ControlNetModel, DDIMScheduler, UNet2DConditionModel
from transformers import CLIPTextConfig, CLIPTextModel

__all__ = ["Checkpoint", "write_full_size_checkpoint", "write_tiny_checkpoint"]


@dataclass(frozen=True)
class Checkpoint:
    """Folders of a base model and of the ControlNet that goes with it."""

    base: Path
    controlnet: Path


# Stable Diffusion 2.1's published configurations.
_SD21_UNET = {
    "sample_size": 96,
    "in_channels": 4,
    "out_channels": 4,
    "block_out_channels": (320, 640, 1280, 1280),
    "down_block_types": ("CrossAttnDownBlock2D",) * 3 + ("DownBlock2D",),
    "up_block_types": ("UpBlock2D",) + ("CrossAttnUpBlock2D",) * 3,
    "layers_per_block": 2,
    "attention_head_dim": (5, 10, 20, 20),
    "cross_attention_dim": 1024,
    "use_linear_projection": True,
    "upcast_attention": True,
}
_SD21_VAE = {
    "block_out_channels": (128, 256, 512, 512),
    "down_block_types": ("DownEncoderBlock2D",) * 4,
    "up_block_types": ("UpDecoderBlock2D",) * 4,
    "layers_per_block": 2,
    "latent_channels": 4,
    "sample_size": 768,
    "scaling_factor": 0.18215,
}
_SD21_TEXT = {
    "vocab_size": 49408,
    "hidden_size": 1024,
    "intermediate_size": 4096,
    "num_hidden_layers": 23,
    "num_attention_heads": 16,
    "max_position_embeddings": 77,
    "hidden_act": "gelu",
    "projection_dim": 512,
}
# Small enough to trace in seconds; three levels, so that an odd size is rounded twice.
_TINY_UNET = _SD21_UNET | {
    "sample_size": 8,
    "block_out_channels": (32, 64, 64),
    "down_block_types": ("CrossAttnDownBlock2D", "CrossAttnDownBlock2D", "DownBlock2D"),
    "up_block_types": ("UpBlock2D", "CrossAttnUpBlock2D", "CrossAttnUpBlock2D"),
    "layers_per_block": 1,
    "attention_head_dim": (2, 4, 4),
    "cross_attention_dim": 32,
    "norm_num_groups": 8,
}
_TINY_VAE = _SD21_VAE | {
    "block_out_channels": (8, 16, 16, 32),
    "layers_per_block": 1,
    "norm_num_groups": 4,
    "sample_size": 64,
}
_TINY_TEXT = _SD21_TEXT | {
    "hidden_size": 32,
    "intermediate_size": 64,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "projection_dim": 32,
}


def write_tiny_checkpoint(
    folder: Path, *, conditioning_channels: int = 11, seed: int = 0, safetensors: bool = True
) -> Checkpoint:
    """Write a checkpoint of about two million parameters; takes well under a second."""
    return _write(
        folder,
        unet=_TINY_UNET,
        vae=_TINY_VAE,
        text=_TINY_TEXT,
        conditioning_channels=conditioning_channels,
        embedding_channels=(8, 8, 16, 16),
        seed=seed,
        safetensors=safetensors,
    )


def write_full_size_checkpoint(
    folder: Path, *, conditioning_channels: int = 11, seed: int = 0
) -> Checkpoint:
    """Write a checkpoint of Stable Diffusion 2.1's size: about 7 GB in float32."""
    return _write(
        folder,
        unet=_SD21_UNET,
        vae=_SD21_VAE,
        text=_SD21_TEXT,
        conditioning_channels=conditioning_channels,
        embedding_channels=(16, 32, 96, 256),
        seed=seed,
        safetensors=True,
    )


def _write(
    folder: Path,
    *,
    unet: dict,
    vae: dict,
    text: dict,
    conditioning_channels: int,
    embedding_channels: tuple[int, ...],
    seed: int,
    safetensors: bool,
) -> Checkpoint:
    base, controlnet = folder / "base", folder / "zerocomp"
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(seed)
        network = UNet2DConditionModel(**unet)
        network.save_pretrained(base / "unet", safe_serialization=safetensors)
        control = ControlNetModel.from_unet(
            network,
            conditioning_channels=conditioning_channels,
            conditioning_embedding_out_channels=embedding_channels,
        )
        del network
        _randomise_zero_convolutions(control)
        control.save_pretrained(controlnet / "controlnet", safe_serialization=safetensors)
        del control
        AutoencoderKL(**vae).save_pretrained(base / "vae", safe_serialization=safetensors)
        CLIPTextModel(CLIPTextConfig(**text)).save_pretrained(base / "text_encoder")
    _write_scheduler(base / "scheduler")
    return Checkpoint(base, controlnet)


def _randomise_zero_convolutions(control: ControlNetModel) -> None:
    zero = [*control.controlnet_down_blocks, control.controlnet_mid_block]
    for layer in [*zero, control.controlnet_cond_embedding.conv_out]:
        torch.nn.init.normal_(layer.weight, std=(0.5 / layer.in_channels) ** 0.5)
        torch.nn.init.normal_(layer.bias, std=0.1)


def _write_scheduler(folder: Path) -> None:
    DDIMScheduler(
        beta_start=0.00085,
        beta_end=0.012,
        beta_schedule="scaled_linear",
        prediction_type="v_prediction",
        set_alpha_to_one=False,
        clip_sample=False,
        steps_offset=1,
    ).save_pretrained(folder)
    assert json.loads((folder / "scheduler_config.json").read_text())["beta_end"] == 0.012
