"""The empty prompt: its tokens, and what the text encoder makes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import torch
from torch import nn

__all__ = ["empty_prompt"]

START_OF_TEXT: Final = 49406
END_OF_TEXT: Final = 49407
OPEN_CLIP_PADDING: Final = 0
"""Stable Diffusion 2's tokenizer pads with "!", the first token of the vocabulary."""


@torch.no_grad()
def empty_prompt(text_encoder: nn.Module, tokenizer: Path | None) -> torch.Tensor:
    """Text encoder's output for the empty prompt, shape (1, tokens, channels).

    Parameters
    ----------
    text_encoder : Module
        A ``CLIPTextModel`` of transformers; its configuration decides width and depth.
    tokenizer : Path or None
        Folder of the tokenizer. Without one the tokens are taken from the two tokenizers that
        Stable Diffusion 1 (CLIP) and 2 (OpenCLIP) were trained with.
    """
    ids = _known_ids(text_encoder) if tokenizer is None else _read_ids(tokenizer)
    return text_encoder(torch.tensor([ids]))[0]


def _known_ids(text_encoder: nn.Module) -> list[int]:
    config = text_encoder.config
    # CLIP's own activation tells the two families apart whatever their size.
    padding = END_OF_TEXT if config.hidden_act == "quick_gelu" else OPEN_CLIP_PADDING
    ids = [START_OF_TEXT, END_OF_TEXT]
    return ids + [padding] * (config.max_position_embeddings - len(ids))


def _read_ids(folder: Path) -> list[int]:
    from transformers import CLIPTokenizer

    tokenizer = CLIPTokenizer.from_pretrained(folder)
    encoded = tokenizer(
        "", padding="max_length", max_length=tokenizer.model_max_length, truncation=True
    )
    return list(encoded.input_ids)
