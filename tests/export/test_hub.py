"""Of a hub repository come the files that are read, and no others."""

from __future__ import annotations

import shutil

import pytest
from support.checkpoints import write_tiny_checkpoint

from spotlight_export.checkpoint import PARTS, open_checkpoint
from spotlight_export.hub import wanted_files

BASE = ("unet", "vae", "scheduler", "text_encoder", "tokenizer")
READ = [
    "unet/config.json",
    "unet/diffusion_pytorch_model.safetensors",
    "vae/config.json",
    "vae/diffusion_pytorch_model.safetensors",
    "scheduler/scheduler_config.json",
    "text_encoder/config.json",
    "text_encoder/model.safetensors",
    "tokenizer/merges.txt",
    "tokenizer/vocab.json",
]
NEVER_READ = [
    "README.md",
    "model_index.json",
    "v2-1_768-ema-pruned.safetensors",
    "v2-1_768-nonema-pruned.ckpt",
    "safety_checker/config.json",
    "safety_checker/model.safetensors",
    "unet/checkpoint-1000/diffusion_pytorch_model.safetensors",
    "unet/diffusion_pytorch_model.bin",
    "unet/diffusion_pytorch_model.fp16.safetensors",
    "unet/diffusion_pytorch_model.non_ema.safetensors",
    "vae/diffusion_pytorch_model.fp16.bin",
    "text_encoder/pytorch_model.bin",
]
SHARDED = [
    "config.json",
    "diffusion_pytorch_model.safetensors.index.json",
    "diffusion_pytorch_model-00001-of-00002.safetensors",
    "diffusion_pytorch_model-00002-of-00002.safetensors",
]


def test_a_base_model_comes_without_what_nobody_reads():
    assert sorted(wanted_files([*READ, *NEVER_READ], BASE)) == sorted(READ)


@pytest.mark.parametrize(
    ("read", "beside"),
    [
        (["config.json", "diffusion_pytorch_model.bin"], ["diffusion_pytorch_model.fp16.bin"]),
        (["config.json", "diffusion_pytorch_model.fp16.safetensors"], ["model.ckpt"]),
        (
            ["config.json", "diffusion_pytorch_model.safetensors"],
            ["checkpoint-1000/config.json", "checkpoint-1000/diffusion_pytorch_model.safetensors"],
        ),
        (
            ["controlnet/config.json", "controlnet/diffusion_pytorch_model.safetensors"],
            ["model.safetensors", "unet/diffusion_pytorch_model.safetensors"],
        ),
        (SHARDED, ["pytorch_model.bin.index.json", "pytorch_model-00001-of-00001.bin"]),
    ],
    ids=["bin alone", "fp16 alone", "with its checkpoints", "in a folder", "in shards"],
)
def test_a_controlnet_comes_as_it_was_published(read, beside):
    assert wanted_files([*read, *beside], ("controlnet",)) == read


def test_a_base_model_is_never_the_repository_itself():
    assert wanted_files(["config.json", "model.safetensors"], BASE) == []


@pytest.mark.parametrize("safetensors", [True, False])
def test_what_comes_can_be_opened(safetensors, tmp_path):
    published = write_tiny_checkpoint(tmp_path / "published", safetensors=safetensors)
    came = []
    for root, parts in ((published.base, BASE), (published.controlnet, ("controlnet",))):
        came.append(tmp_path / "came" / root.name)
        names = [file.relative_to(root).as_posix() for file in root.rglob("*") if file.is_file()]
        for name in wanted_files(names, parts):
            (came[-1] / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(root / name, came[-1] / name)
    opened = open_checkpoint(*map(str, came))
    for part in PARTS:
        opened.load(part)
    assert opened.config("scheduler")
