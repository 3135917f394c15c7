"""Which variants of diffusers' networks the exported forwards reproduce."""

from __future__ import annotations

from typing import Any, Final

from spotlight_export.errors import UnsupportedArchitectureError

__all__ = ["check_denoiser_config", "check_vae_config"]

BLOCK_TYPES: Final = {
    "CrossAttnDownBlock2D",
    "DownBlock2D",
    "UNetMidBlock2DCrossAttn",
    "CrossAttnUpBlock2D",
    "UpBlock2D",
}
PLAIN_DENOISER: Final[dict[str, tuple[Any, ...]]] = {
    "addition_embed_type": (None,),
    "attention_type": ("default",),
    "center_input_sample": (False,),
    "class_embed_type": (None,),
    "controlnet_conditioning_channel_order": ("rgb",),
    "dual_cross_attention": (False,),
    "encoder_hid_dim": (None,),
    "encoder_hid_dim_type": (None,),
    "mid_block_type": ("UNetMidBlock2DCrossAttn",),
    "num_class_embeds": (None,),
    "time_cond_proj_dim": (None,),
    "time_embedding_act_fn": (None,),
    "time_embedding_type": ("positional",),
}
"""Settings that add arithmetic when they differ; absent ones are at these defaults."""

PLAIN_VAE: Final[dict[str, tuple[Any, ...]]] = {
    "latents_mean": (None,),
    "latents_std": (None,),
    "shift_factor": (None, 0.0),
}


def check_denoiser_config(part: str, config: dict[str, Any]) -> None:
    """Refuse a UNet or ControlNet whose forward does more than Stable Diffusion 1 and 2 do."""
    _check(part, config, PLAIN_DENOISER)
    used = {*config.get("down_block_types", ()), *config.get("up_block_types", ())}
    if unknown := sorted(used - BLOCK_TYPES):
        raise UnsupportedArchitectureError(
            f"{part}/config.json uses {unknown[0]}; expected only {', '.join(sorted(BLOCK_TYPES))}"
            ", the blocks of Stable Diffusion 1 and 2"
        )


def check_vae_config(config: dict[str, Any]) -> None:
    """Refuse a VAE whose latents are normalised by more than one factor."""
    _check("vae", config, PLAIN_VAE)


def _check(part: str, config: dict[str, Any], plain: dict[str, tuple[Any, ...]]) -> None:
    for name, allowed in plain.items():
        value = config.get(name, allowed[0])
        if value not in allowed:
            raise UnsupportedArchitectureError(
                f"{part}/config.json sets {name} to {value!r}; expected "
                f"{' or '.join(map(repr, allowed))}. The exporter reproduces Stable Diffusion 1 "
                "and 2; convert the checkpoint to their architecture"
            )
