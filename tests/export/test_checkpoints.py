"""Checkpoints that are not quite what they should be get one clear error."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from safetensors.torch import load_file, save_file
from support.checkpoints import Checkpoint, write_tiny_checkpoint

from spotlight_export.adoption import adopt_configuration
from spotlight_export.architecture import check_denoiser_config, check_vae_config
from spotlight_export.checkpoint import open_checkpoint
from spotlight_export.errors import (
    CheckpointError,
    ConditioningChannelsError,
    ExportError,
    MissingWeightsError,
    UnsupportedArchitectureError,
)
from spotlight_export.export import export_backbone, find_backbone
from spotlight_export.prompt import empty_prompt
from spotlight_spec import BACKBONES


@pytest.fixture
def copy(checkpoint: Checkpoint, tmp_path: Path) -> Checkpoint:
    shutil.copytree(checkpoint.base, tmp_path / "base")
    shutil.copytree(checkpoint.controlnet, tmp_path / "zerocomp")
    return Checkpoint(tmp_path / "base", tmp_path / "zerocomp")


def edit(path: Path, **changes: object) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize("part", ["unet", "vae", "scheduler", "text_encoder"])
def test_a_missing_part_is_named(part, copy):
    shutil.rmtree(copy.base / part)
    with pytest.raises(MissingWeightsError, match=f"no {part}/ folder"):
        open_checkpoint(str(copy.base), str(copy.controlnet))


def test_a_missing_tokenizer_is_fine_and_its_tokens_known(checkpoint):
    opened = open_checkpoint(str(checkpoint.base), str(checkpoint.controlnet))
    prompt = opened.prompt()
    assert prompt.shape == (1, 77, 32)
    encoder = opened.load("text_encoder")
    encoder.config.hidden_act = "quick_gelu"  # CLIP's own: padded with the end token instead
    other = empty_prompt(encoder, None)
    assert (other[:, :2] == prompt[:, :2]).all()
    assert (other[:, 2:] != prompt[:, 2:]).any()


def test_controlnet_folder_or_its_parent(checkpoint):
    parent = open_checkpoint(str(checkpoint.base), str(checkpoint.controlnet))
    itself = open_checkpoint(str(checkpoint.base), str(checkpoint.controlnet / "controlnet"))
    assert parent.folders == itself.folders


def test_a_finetuned_unet_replaces_the_bases(checkpoint, tmp_path):
    shutil.copytree(checkpoint.base / "unet", tmp_path / "unet")
    opened = open_checkpoint(str(checkpoint.base), str(checkpoint.controlnet), str(tmp_path))
    assert opened.folders["unet"] == tmp_path / "unet"


def test_bin_and_safetensors_hold_the_same_network(checkpoint, tmp_path):
    pickled = write_tiny_checkpoint(tmp_path, safetensors=False)
    digests = []
    for source in (checkpoint, pickled):
        opened = open_checkpoint(str(source.base), str(source.controlnet))
        opened.load("unet")
        digests.append(opened.digests["unet"])
    assert digests[0] == digests[1]


@pytest.mark.parametrize("name", ["weights.bin", "not-there", "a/b/c"])
def test_neither_folder_nor_hub_id(name, checkpoint):
    with pytest.raises(MissingWeightsError, match="is not a folder"):
        open_checkpoint(name, str(checkpoint.controlnet))


def test_unreachable_hub(checkpoint, monkeypatch):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    with pytest.raises(MissingWeightsError, match="neither a folder here nor"):
        open_checkpoint("nobody/no-such-model", str(checkpoint.controlnet))


def test_wrong_channels_name_the_backbone_that_fits(checkpoint, tmp_path):
    with pytest.raises(ConditioningChannelsError) as caught:
        export_backbone(
            "zerocomp-interiorverse", checkpoint.base, checkpoint.controlnet, tmp_path / "out"
        )
    assert "takes 11 conditioning channels" in str(caught.value)
    assert "has 13" in str(caught.value)
    assert "zerocomp-openrooms" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_corrupted_bin_is_named(tmp_path):
    broken = write_tiny_checkpoint(tmp_path, safetensors=False)
    file = broken.base / "unet" / "diffusion_pytorch_model.bin"
    file.write_bytes(file.read_bytes()[:50_000])
    with pytest.raises(CheckpointError, match=r"diffusion_pytorch_model\.bin cannot be read"):
        open_checkpoint(str(broken.base), str(broken.controlnet)).load("unet")


def test_truncated_safetensors_are_named(copy):
    file = copy.base / "vae" / "diffusion_pytorch_model.safetensors"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match=r"vae/diffusion_pytorch_model\.safetensors"):
        open_checkpoint(str(copy.base), str(copy.controlnet)).load("vae")


@pytest.mark.parametrize("part", ["unet", "text_encoder"])
def test_a_missing_tensor_is_never_filled_with_noise(part, copy):
    file = next((copy.base / part).glob("*.safetensors"))
    tensors = load_file(file)
    lost = sorted(tensors)[0]
    del tensors[lost]
    save_file(tensors, file, metadata={"format": "pt"})
    with pytest.raises(CheckpointError, match=lost.replace(".", r"\.")):
        open_checkpoint(str(copy.base), str(copy.controlnet)).load(part)


def test_no_weights_at_all(copy):
    next((copy.base / "unet").glob("*.safetensors")).unlink()
    with pytest.raises(MissingWeightsError, match="has no weights"):
        open_checkpoint(str(copy.base), str(copy.controlnet)).load("unet")


def test_a_damaged_configuration_is_named(copy):
    (copy.base / "vae" / "config.json").write_text("{")
    with pytest.raises(CheckpointError, match=r"config\.json: expected JSON"):
        open_checkpoint(str(copy.base), str(copy.controlnet)).config("vae")


@pytest.mark.parametrize(
    ("setting", "value"),
    [("class_embed_type", "timestep"), ("down_block_types", ["KDownBlock2D"])],
)
def test_other_architectures_are_refused(setting, value):
    with pytest.raises(UnsupportedArchitectureError, match="Stable Diffusion 1"):
        check_denoiser_config("unet", {setting: value})


def test_a_shifted_latent_space_is_refused():
    with pytest.raises(UnsupportedArchitectureError, match="shift_factor"):
        check_vae_config({"shift_factor": 0.1})


def test_unknown_backbone_lists_the_known():
    with pytest.raises(ExportError, match="zerocomp-inverted"):
        find_backbone("zerocmp")
    assert find_backbone("zerocomp") is BACKBONES["zerocomp-openrooms"]


def test_the_checkpoints_own_schedule_is_recorded_but_not_its_spacing():
    spec, warnings = adopt_configuration(
        BACKBONES["zerocomp-openrooms"],
        {"scaling_factor": 0.5, "block_out_channels": [8, 8, 8, 8]},
        {
            "set_alpha_to_one": True,
            "beta_end": 0.02,
            "timestep_spacing": "leading",
            "rescale_betas_zero_snr": False,
        },
    )
    assert spec.latent.scaling_factor == 0.5
    assert spec.schedule.set_alpha_to_one
    assert spec.schedule.beta_end == 0.02
    assert spec.schedule.timestep_spacing == "trailing"
    assert spec.schedule.rescale_betas_zero_snr
    assert len(warnings) == 2
    assert "scaling_factor = 0.5" in warnings[0]


def test_epsilon_prediction_cannot_have_zero_terminal_snr():
    with pytest.raises(CheckpointError, match="v_prediction"):
        adopt_configuration(BACKBONES["zerocomp-openrooms"], {}, {"prediction_type": "epsilon"})
