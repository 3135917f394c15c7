"""Read checkpoints in the layout diffusers publishes, and refuse what is not quite one."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from spotlight_export.errors import (
    CheckpointError,
    ConditioningChannelsError,
    MissingWeightsError,
)
from spotlight_export.hub import WEIGHT_FILES, fetch, weight_file
from spotlight_export.prompt import empty_prompt
from spotlight_export.quiet import quiet_libraries
from spotlight_spec import BACKBONES, BackboneSpec

__all__ = ["PARTS", "Checkpoint", "open_checkpoint"]

PARTS: Final = ("text_encoder", "vae", "controlnet", "unet")
"""Networks a fingerprint covers, in the order they are loaded."""

HUB_ID: Final = re.compile(r"[\w.-]+/[\w.-]+")


@dataclass(frozen=True)
class Checkpoint:
    """A base model and a ControlNet on disk; networks are loaded when asked for, in float32.

    Attributes
    ----------
    folders : dict of Path
        Folder of each part, ``tokenizer`` only where there is one.
    digests : dict of str
        sha256 of each part loaded so far.
    """

    folders: dict[str, Path]
    digests: dict[str, str] = field(default_factory=dict)

    def config(self, part: str) -> dict[str, Any]:
        """Configuration of a part, as stored."""
        name = "scheduler_config.json" if part == "scheduler" else "config.json"
        path = self.folders[part] / name
        try:
            config: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise MissingWeightsError(
                f"{path} is missing; expected the {part} folder as diffusers writes it. "
                "Download the checkpoint again"
            ) from error
        except ValueError as error:
            raise CheckpointError(f"{path}: expected JSON, got {error}") from error
        return config

    def load(self, part: str) -> nn.Module:
        """Load a network in float32 for inference and note its digest."""
        network = _load(_network_class(part), self.folders[part])
        self.digests[part] = _digest(network)
        return network

    def prompt(self) -> torch.Tensor:
        """Text encoder's output for the empty prompt, shape (1, tokens, channels)."""
        return empty_prompt(self.load("text_encoder"), self.folders.get("tokenizer"))

    def fingerprint(self) -> str:
        """sha256 over the names, shapes and bytes of all weights, once every part was loaded."""
        return hashlib.sha256("\n".join(self.digests[part] for part in PARTS).encode()).hexdigest()

    def check_conditioning(self, spec: BackboneSpec) -> None:
        """Refuse a ControlNet trained for another number of conditioning channels."""
        channels = self.config("controlnet").get("conditioning_channels", 3)
        if channels == spec.conditioning_channels:
            return
        matching = [
            other.name
            for other in BACKBONES.values()
            if other.conditioning_channels == channels and other.conditioning_layout == "controlnet"
        ]
        hint = f"; {' and '.join(matching)} have {channels}" if matching else ""
        raise ConditioningChannelsError(
            f"{self.folders['controlnet']}: this ControlNet takes {channels} conditioning "
            f"channels, backbone {spec.name!r} has {spec.conditioning_channels} "
            f"({', '.join(entry.name for entry in spec.maps)}){hint}. Name the backbone the "
            "checkpoint was trained for"
        )


def open_checkpoint(base: str, controlnet: str, unet: str | None = None) -> Checkpoint:
    """Find the parts of a checkpoint without loading any.

    Parameters
    ----------
    base : str
        Folder with ``unet vae scheduler text_encoder`` and perhaps ``tokenizer``, or a hub id.
    controlnet : str
        ControlNet's folder, the folder that holds it as ``controlnet``, or a hub id.
    unet : str, optional
        A finetuned UNet to use in place of the base model's, found likewise.

    Raises
    ------
    MissingWeightsError
        If a part is nowhere to be found.
    """
    root = _local_folder(base, ("unet", "vae", "scheduler", "text_encoder", "tokenizer"))
    folders = {part: _part(root, part, base) for part in ("text_encoder", "vae", "scheduler")} | {
        "controlnet": _part_or_itself(controlnet, "controlnet"),
        "unet": _part_or_itself(unet, "unet") if unet else _part(root, "unet", base),
    }
    if (root / "tokenizer").is_dir():
        folders["tokenizer"] = root / "tokenizer"
    return Checkpoint(folders)


def _local_folder(source: str, parts: tuple[str, ...]) -> Path:
    path = Path(source).expanduser()
    if path.is_dir():
        return path
    if path.exists() or not HUB_ID.fullmatch(source):
        raise MissingWeightsError(
            f"{source} is not a folder; expected a checkpoint as diffusers writes it "
            f"({', '.join(parts)}) or a hub id like owner/name"
        )
    try:
        return fetch(source, parts)
    except Exception as error:
        raise MissingWeightsError(
            f"{source} is neither a folder here nor a checkpoint the hub gives out "
            f"({type(error).__name__}: {str(error).strip().splitlines()[0]}). Download it "
            "elsewhere and pass its folder"
        ) from error


def _part(root: Path, part: str, source: str) -> Path:
    if not (root / part).is_dir():
        found = ", ".join(sorted(p.name for p in root.iterdir() if p.is_dir())) or "no folder"
        raise MissingWeightsError(
            f"{source} has no {part}/ folder; expected unet, vae, scheduler and text_encoder, "
            f"found {found}. Pass the folder that holds model_index.json"
        )
    return root / part


def _part_or_itself(source: str, part: str) -> Path:
    root = _local_folder(source, (part,))
    folder = root / part if (root / part).is_dir() else root
    if not (folder / "config.json").is_file():
        raise MissingWeightsError(
            f"{source} holds neither config.json nor {part}/config.json; pass the folder that "
            f"{part} was saved to, or its parent"
        )
    return folder


def _network_class(part: str) -> Any:
    if part == "text_encoder":
        from transformers import CLIPTextModel

        return CLIPTextModel
    import diffusers

    return {
        "unet": diffusers.UNet2DConditionModel,
        "controlnet": diffusers.ControlNetModel,
        "vae": diffusers.AutoencoderKL,
    }[part]


def _load(network_class: Any, folder: Path) -> nn.Module:
    preferred = weight_file([path.name for path in folder.iterdir() if path.is_file()])
    if preferred is None:
        found = ", ".join(sorted(path.name for path in folder.iterdir())) or "nothing"
        raise MissingWeightsError(
            f"{folder} has no weights; expected {WEIGHT_FILES[0]}.safetensors or .bin, found "
            f"{found}. Download the checkpoint again"
        )
    file, variant = preferred
    with quiet_libraries():
        try:
            network, report = network_class.from_pretrained(
                folder,
                torch_dtype=torch.float32,
                low_cpu_mem_usage=True,
                local_files_only=True,
                use_safetensors=".safetensors" in file,
                variant=variant,
                output_loading_info=True,
            )
        except Exception as error:
            raise CheckpointError(
                f"{folder / file} cannot be read as {network_class.__name__}: "
                f"{str(error).strip().splitlines()[0] or type(error).__name__}. The file is "
                "damaged or of another architecture; compare its checksum or download it again"
            ) from error
    absent = sorted(str(name) for name in [*report["missing_keys"], *report["mismatched_keys"]])
    if absent:
        raise MissingWeightsError(
            f"{folder / file} lacks {len(absent)} of the tensors its config.json calls for, "
            f"first {absent[0]!r}; the weights belong to another configuration. Download both "
            "files again"
        )
    return network.eval().requires_grad_(False)


def _digest(network: nn.Module) -> str:
    digest = hashlib.sha256()
    for name, tensor in sorted(network.state_dict().items()):
        digest.update(f"{name} {tuple(tensor.shape)}\n".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy())
    return digest.hexdigest()
