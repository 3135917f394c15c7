"""The published checkpoints, as published: order, channels and ranges of their conditioning."""

import dataclasses

import pytest

from spotlight_spec import BACKBONES


@pytest.mark.parametrize(
    ("name", "order", "channels"),
    [
        ("zerocomp-openrooms", "depth normal albedo shading mask", 11),
        ("zerocomp-openrooms-wo-depth", "normal albedo shading mask", 10),
        (
            "zerocomp-interiorverse",
            "depth normal albedo shading mask roughness metallic",
            13,
        ),
        ("zerocomp-inverted", "depth normal albedo shading mask", 11),
    ],
)
def test_order_and_channels(name, order, channels):
    spec = BACKBONES[name]
    assert [entry.name for entry in spec.maps] == order.split()
    assert spec.conditioning_channels == channels


@pytest.mark.parametrize("name", BACKBONES)
def test_entries_are_filed_under_their_own_name(name):
    assert BACKBONES[name].name == name
    assert BACKBONES[name].title


@pytest.mark.parametrize("spec", BACKBONES.values(), ids=BACKBONES)
def test_ranges_and_fill(spec):
    maps = {entry.name: entry for entry in spec.maps}
    assert (maps["shading"].minimum, maps["shading"].maximum) == (1e-5, 1e3)
    assert maps["shading"].fill == -1.0
    assert (maps["mask"].fill, maps["mask"].maximum) == (-1.0, 1.0)
    assert all(maps[name].fill is None for name in maps if name not in ("shading", "mask"))
    if "depth" in maps:
        assert (maps["depth"].minimum, maps["depth"].maximum) == (0.0, 20.0)


@pytest.mark.parametrize("name", [n for n in BACKBONES if n.startswith("zerocomp")])
def test_stable_diffusion_latents_and_schedule(name):
    spec = BACKBONES[name]
    latent, schedule = spec.latent, spec.schedule
    assert (latent.channels, latent.downscale, latent.scaling_factor) == (4, 8, 0.18215)
    assert (schedule.beta_start, schedule.beta_end) == (0.00085, 0.012)
    assert (schedule.prediction_type, schedule.timestep_spacing) == ("v_prediction", "trailing")
    assert schedule.rescale_betas_zero_snr
    assert schedule.steps == 20
    assert spec.image_encoding == "gamma22"


def test_only_the_inverted_backbone_knows_the_inside():
    inside = [name for name, spec in BACKBONES.items() if spec.shading.known == "inside"]
    assert inside == ["zerocomp-inverted"]


def test_specs_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        BACKBONES["mini"].size = 1
