"""What each exported graph takes and returns."""

import pytest

from spotlight_spec import BACKBONES, graph_contracts

RESIDUALS = (320, 640, 1280)


def by_name(spec, **kwargs):
    return {c.name: c for c in graph_contracts(spec, condition_channels=320, **kwargs)}


@pytest.mark.parametrize("spec", BACKBONES.values(), ids=BACKBONES)
def test_fused_graphs_in_the_order_first_needed(spec):
    graphs = by_name(spec)
    assert list(graphs) == ["vae_encoder", "condition_encoder", "denoiser", "vae_decoder"]
    assert graphs["condition_encoder"].inputs[0].shape[1] == spec.conditioning_channels
    latents = graphs["denoiser"].inputs[0]
    assert latents.shape == ("batch", spec.latent.channels, "latent_height", "latent_width")
    assert [t.name for t in graphs["denoiser"].inputs] == ["latents", "timestep", "condition"]


def test_split_graphs_pass_the_residuals_on():
    graphs = by_name(BACKBONES["zerocomp-openrooms"], residual_channels=RESIDUALS)
    assert list(graphs) == ["vae_encoder", "condition_encoder", "controlnet", "unet", "vae_decoder"]
    residuals = graphs["controlnet"].outputs
    assert [t.shape[1] for t in residuals] == list(RESIDUALS)
    assert graphs["unet"].inputs[2:] == residuals
    assert "condition" not in [t.name for t in graphs["unet"].inputs]


def test_a_shallow_graph_takes_what_the_whole_one_kept():
    graphs = by_name(BACKBONES["mini"], deep_channels=128)
    assert list(graphs)[2:4] == ["denoiser", "denoiser_shallow"]
    whole, shallow = graphs["denoiser"], graphs["denoiser_shallow"]
    assert [t.name for t in whole.outputs] == ["prediction", "deep"]
    assert shallow.inputs == (*whole.inputs, whole.outputs[1])
    assert shallow.outputs == whole.outputs[:1]


@pytest.mark.parametrize("passed_on", [{}, {"residual_channels": RESIDUALS}, {"deep_channels": 8}])
def test_what_one_graph_returns_the_next_one_takes(passed_on):
    """A tensor has one name, type and shape wherever it passes."""
    seen = {}
    graphs = by_name(BACKBONES["mini"], **passed_on)
    for contract in graphs.values():
        for tensor in (*contract.inputs, *contract.outputs):
            key = (tensor.name, tensor.dtype, tensor.shape)
            assert seen.setdefault(tensor.name, key) == key


def test_only_the_timestep_is_an_integer_and_shared_by_the_batch():
    for contract in graph_contracts(BACKBONES["mini"], condition_channels=6):
        for tensor in (*contract.inputs, *contract.outputs):
            timestep = tensor.name == "timestep"
            assert tensor.dtype == ("int64" if timestep else "float32")
            assert (tensor.shape == (1,)) == timestep


def test_sizes_are_dynamic():
    for contract in graph_contracts(BACKBONES["mini"], condition_channels=6):
        for tensor in (*contract.inputs, *contract.outputs):
            if tensor.name != "timestep":
                assert tensor.shape[0] == "batch"
                assert all(isinstance(side, str) for side in tensor.shape[2:])


def test_file_name_follows_the_graph():
    for contract in graph_contracts(BACKBONES["mini"], condition_channels=6):
        assert contract.file_name == f"{contract.name}.onnx"
