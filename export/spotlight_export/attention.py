"""Attention as it is exported: the prompt's keys and values become constants.

SpotLight's prompt is always empty, so every cross-attention layer attends to the same tokens at
every step of every image. Their keys and values are computed here, once; the projections that
made them, and the text encoder before those, are then no longer needed.

Everything about how attention is written into a graph lives in this module and nowhere else.
"""

from __future__ import annotations

from typing import Final

import onnx_ir as ir
import onnx_ir.passes.common as passes
import torch
from torch import nn
from torch.nn.functional import scaled_dot_product_attention

from spotlight_export.errors import UnsupportedArchitectureError

__all__ = ["fold_prompt", "fuse_self_attention"]

FUSED_DOMAIN: Final = "com.microsoft"
HEADS_FIRST: Final = (0, 2, 1, 3)
"""Permutation between (batch, tokens, heads, channels) and (batch, heads, tokens, channels)."""


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


def fuse_self_attention(model: ir.Model) -> None:
    """Write self-attention as ONNX Runtime's own operator, which never holds all scores; in place.

    ``MultiHeadAttention`` takes half of the time that ``Attention`` does at 4096 tokens, and a
    third of a gigabyte less. It is no standard ONNX, so it is for graphs that are ONNX Runtime's
    alone. Attention to the prompt stays: with 77 tokens the standard operator is the quicker one.
    """
    graph = model.graph
    for node in [node for node in graph if node.op_type == "Attention"]:
        split = [_split_of(value) for value in node.inputs]
        merged = _only_user(node, "Transpose")
        joined = None if merged is None else _only_user(merged, "Reshape")
        heads = None if split[0] is None else _heads(split[0])
        if len(split) != 3 or None in split or joined is None or heads is None:
            continue
        tokens = [reshape.inputs[0] for reshape in split if reshape is not None]
        scale = node.attributes.get("scale")
        attributes = {"num_heads": heads} | ({} if scale is None else {"scale": scale.as_float()})
        fused = ir.node("MultiHeadAttention", tokens, attributes, domain=FUSED_DOMAIN)
        graph.insert_before(joined, fused)
        before, after = joined.outputs[0], fused.outputs[0]
        ir.convenience.replace_all_uses_with(before, after, replace_graph_outputs=True)
        name = before.name  # a quantiser knows its range by it
        graph.remove(joined, safe=True)
        after.name = name
        model.opset_imports[FUSED_DOMAIN] = 1
    passes.RemoveUnusedNodesPass()(model)


def _split_of(value: ir.Value | None) -> ir.Node | None:
    """The Reshape that splits tokens (B, N, H·D) into heads, before they are transposed."""
    transposed = None if value is None else value.producer()
    if transposed is None or transposed.op_type != "Transpose":
        return None
    if tuple(transposed.attributes["perm"].as_ints()) != HEADS_FIRST:
        return None
    split = transposed.inputs[0].producer()
    return split if split is not None and split.op_type == "Reshape" else None


def _only_user(node: ir.Node, op_type: str) -> ir.Node | None:
    users = [user for user, _ in node.outputs[0].uses()]
    return users[0] if len(users) == 1 and users[0].op_type == op_type else None


def _heads(split: ir.Node) -> int | None:
    """How many heads a Reshape to (B, N, H, D) makes, where that is a constant."""
    shape = split.inputs[1].producer()
    if shape is None or shape.op_type != "Concat" or len(shape.inputs) != 4:
        return None
    size = ir.convenience.get_const_tensor(shape.inputs[2])
    return None if size is None else int(size.numpy().item())
