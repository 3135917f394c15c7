"""Attention as it is exported: the prompt's keys and values become constants.

SpotLight's prompt is always empty, so every cross-attention layer attends to the same tokens at
every step of every image. Their keys and values are computed here, once; the projections that
made them, and the text encoder before those, are then no longer needed.

Everything about how attention is written into a graph lives in this module and nowhere else.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn.functional import scaled_dot_product_attention

from spotlight_export.errors import UnsupportedArchitectureError

__all__ = ["fold_prompt"]


class SelfAttention(nn.Module):
    """Attention of image tokens among themselves, to be set as a diffusers layer's processor."""

    def forward(
        self,
        layer: nn.Module,
        tokens: torch.Tensor,
        encoder_hidden_states: None = None,
        attention_mask: None = None,
    ) -> torch.Tensor:
        """Attend; the two last arguments exist for diffusers' calling convention."""
        q, k, v = (
            _split_heads(project(tokens), layer.heads)
            for project in (layer.to_q, layer.to_k, layer.to_v)
        )
        return _project_out(layer, scaled_dot_product_attention(q, k, v))


class PromptAttention(nn.Module):
    """Attention of image tokens to a constant prompt.

    Parameters
    ----------
    keys, values : Tensor, shape (1, heads, prompt tokens, head dimension)
    """

    def __init__(self, keys: torch.Tensor, values: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("keys", keys)
        self.register_buffer("values", values)

    def forward(
        self,
        layer: nn.Module,
        tokens: torch.Tensor,
        encoder_hidden_states: None = None,
        attention_mask: None = None,
    ) -> torch.Tensor:
        """Attend; the two last arguments exist for diffusers' calling convention."""
        q = _split_heads(layer.to_q(tokens), layer.heads)
        shape = (q.shape[0], -1, -1, -1)
        attended = scaled_dot_product_attention(
            q, self.keys.expand(shape), self.values.expand(shape)
        )
        return _project_out(layer, attended)


@torch.no_grad()
def fold_prompt(network: nn.Module, prompt: torch.Tensor) -> None:
    """Replace every attention layer of ``network`` by its exported form, in place.

    Parameters
    ----------
    network : Module
        A UNet or ControlNet of diffusers.
    prompt : Tensor, shape (1, tokens, channels)
        The text encoder's output for the empty prompt.
    """
    for path, block in network.named_modules():
        if not hasattr(block, "attn1"):
            continue
        _check_plain(path, block)
        block.attn1.set_processor(SelfAttention())
        layer = block.attn2
        keys, values = (
            _split_heads(project(prompt), layer.heads).contiguous()
            for project in (layer.to_k, layer.to_v)
        )
        layer.set_processor(PromptAttention(keys, values))
        del layer.to_k, layer.to_v


def _check_plain(path: str, block: nn.Module) -> None:
    """Refuse variants whose arithmetic differs from what is exported here."""
    if block.attn2 is None or block.only_cross_attention:
        raise UnsupportedArchitectureError(
            f"{path} has no self- and cross-attention pair; only the transformer blocks of "
            "Stable Diffusion 1 and 2 can be exported"
        )
    for name in ("attn1", "attn2"):
        layer = getattr(block, name)
        plain = (
            layer.norm_q is None
            and layer.norm_k is None
            and layer.norm_cross is None
            and layer.group_norm is None
            and layer.spatial_norm is None
            and not layer.residual_connection
            and layer.rescale_output_factor == 1.0
        )
        if not plain:
            raise UnsupportedArchitectureError(
                f"{path}.{name} normalises or rescales inside attention; only the attention "
                "layers of Stable Diffusion 1 and 2 can be exported"
            )


def _split_heads(tokens: torch.Tensor, heads: int) -> torch.Tensor:
    batch, count, channels = tokens.shape
    return tokens.view(batch, count, heads, channels // heads).transpose(1, 2)


def _project_out(layer: nn.Module, attended: torch.Tensor) -> torch.Tensor:
    batch, heads, count, channels = attended.shape
    return layer.to_out[0](attended.transpose(1, 2).reshape(batch, count, heads * channels))
