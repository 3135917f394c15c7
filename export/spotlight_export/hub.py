"""Which files of a checkpoint are read, and their way from the Hugging Face hub; no others come."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Final

__all__ = ["WEIGHT_FILES", "fetch", "wanted_files", "weight_file"]

WEIGHT_FILES: Final = ("diffusion_pytorch_model", "model", "pytorch_model")
INDEX: Final = ".index.json"


def weight_file(names: Collection[str]) -> tuple[str, str | None] | None:
    """First weight file in order of preference, and the variant diffusers knows it by."""
    for variant, suffix in (
        (None, ".safetensors"),
        (None, f".safetensors{INDEX}"),
        (None, ".bin"),
        (None, f".bin{INDEX}"),
        ("fp16", ".fp16.safetensors"),
        ("fp16", ".fp16.bin"),
    ):
        for stem in WEIGHT_FILES:
            if f"{stem}{suffix}" in names:
                return f"{stem}{suffix}", variant
    return None


def wanted_files(names: Iterable[str], parts: Collection[str]) -> list[str]:
    """Of a repository's files those that its parts are read from.

    Parameters
    ----------
    names : iterable of str
        Paths in the repository.
    parts : collection of str
        Folders of the parts; a single part may be the repository itself.

    Returns
    -------
    list of str
        Each part's configuration and the weights that `weight_file` prefers.
    """
    folders: dict[str, list[str]] = {}
    for name in names:
        folder, _, file = name.rpartition("/")
        folders.setdefault(folder, []).append(file)
    held = [part for part in parts if part in folders]
    if not held and len(parts) == 1:
        held = [""]
    return [
        f"{folder}/{file}".removeprefix("/")
        for folder in held
        for file in _read(folders.get(folder, []))
    ]


def fetch(source: str, parts: Collection[str]) -> Path:
    """Download the parts of a checkpoint and return the folder they are in.

    Raises
    ------
    Exception
        Whatever the hub's library raises where it gives out nothing.
    """
    from huggingface_hub import HfApi, snapshot_download

    try:
        files = HfApi().list_repo_files(source)
    except Exception:
        # What is there from before will do; where nothing is, this says why.
        return Path(snapshot_download(source, allow_patterns=[]))
    wanted = wanted_files(files, parts)
    if not wanted:
        raise FileNotFoundError(f"none of {', '.join(parts)} among its files")
    return Path(snapshot_download(source, allow_patterns=wanted))


def _read(files: list[str]) -> list[str]:
    """Configuration and preferred weights among the files of one folder."""
    preferred = weight_file(files)
    weights = preferred[0] if preferred else ""
    stem, _, suffix = weights.removesuffix(INDEX).rpartition(".")
    shard = re.compile(rf"{re.escape(stem)}-\d+-of-\d+\.{suffix}")
    return [
        file
        for file in files
        if file == weights
        or (weights.endswith(INDEX) and shard.fullmatch(file))
        or (file.endswith((".json", ".txt")) and not file.endswith(INDEX))
    ]
