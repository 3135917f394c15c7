"""Whatever a network predicts and however it is cut into graphs, the sampler sees v."""

from dataclasses import replace

import numpy as np
import pytest

from spotlight_runtime.diffusion.schedule import alphas_cumprod
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.networks.models import open_networks, predictor, resolve_model
from spotlight_spec import ScheduleSpec

SPEC = ScheduleSpec()
SHAPE = (2, 4, 3, 5)


def split_network(answer):
    """A ControlNet and a UNet as plain functions; ``answer`` is what the UNet says."""
    calls = []

    def controlnet(latents, timestep, condition):
        calls.append(("controlnet", latents.shape, timestep.tolist(), condition.shape))
        assert timestep.dtype == np.int64
        return {"residual_0": 2.0 * condition, "residual_1": latents}

    def unet(latents, timestep, residual_0, residual_1):
        calls.append(("unet", latents.shape, timestep.tolist(), residual_0.shape))
        np.testing.assert_array_equal(residual_1, latents)
        return {"prediction": answer(latents, residual_0)}

    return {"controlnet": controlnet, "unet": unet}, calls


def test_split_layout_passes_residuals_and_one_timestep(rng):
    z, condition = rng.standard_normal((2, *SHAPE), dtype=np.float32)
    networks, calls = split_network(lambda latents, residual: latents + residual)
    got = predictor(networks, condition, SPEC)(z, 499)
    np.testing.assert_array_equal(got, z + 2.0 * condition)
    assert calls == [("controlnet", SHAPE, [499], SHAPE), ("unet", SHAPE, [499], SHAPE)]


def test_branches_one_after_the_other_are_the_same(rng):
    z, condition = rng.standard_normal((2, *SHAPE), dtype=np.float32)
    networks, calls = split_network(lambda latents, residual: np.sin(latents) + residual)
    together = predictor(networks, condition, SPEC)(z, 999)
    apart = predictor(networks, condition, SPEC, batch_branches=False)(z, 999)
    np.testing.assert_array_equal(apart, together)
    assert [call[1][0] for call in calls] == [2, 2, 1, 1, 1, 1]


def test_branches_of_a_real_graph_agree(backbone, rng):
    networks = open_networks(resolve_model(backbone), threads=1)
    z = rng.standard_normal((2, 4, 5, 7), dtype=np.float32)
    condition = rng.standard_normal((2, 6, 5, 7), dtype=np.float32)
    together = predictor(networks, condition, SPEC)(z, 499)
    apart = predictor(networks, condition, SPEC, batch_branches=False)(z, 499)
    np.testing.assert_allclose(apart, together, atol=1e-6)
    assert np.abs(together).max() > 0.01


def knowing(kind, x0, noise):
    """A network that predicts the truth in its own way."""
    alphas = alphas_cumprod(replace(SPEC, rescale_betas_zero_snr=kind != "epsilon"))

    def denoiser(latents, timestep, condition):
        level = alphas[int(timestep[0])]
        v = np.sqrt(level) * noise - np.sqrt(1.0 - level) * x0
        return {"prediction": {"epsilon": noise, "sample": x0, "v_prediction": v}[kind]}

    return {"denoiser": denoiser}, alphas


@pytest.mark.parametrize("kind", ["v_prediction", "epsilon", "sample"])
@pytest.mark.parametrize("timestep", [0, 49, 499, 998, 999])
def test_every_prediction_is_the_same_velocity(kind, timestep, rng):
    x0, noise = rng.standard_normal((2, *SHAPE))
    networks, alphas = knowing(kind, x0, noise)
    spec = replace(SPEC, prediction_type=kind, rescale_betas_zero_snr=kind != "epsilon")
    level = alphas[timestep]
    z = np.sqrt(level) * x0 + np.sqrt(1.0 - level) * noise
    got = predictor(networks, z, spec)(z, timestep)
    wanted = np.sqrt(level) * noise - np.sqrt(1.0 - level) * x0
    np.testing.assert_allclose(got, wanted, atol=1e-9)


@pytest.mark.parametrize("kind", ["v_prediction", "sample"])
def test_float32_stays_float32(kind, rng):
    z, answer = rng.standard_normal((2, *SHAPE), dtype=np.float32)
    networks = {"denoiser": lambda latents, timestep, condition: {"prediction": answer}}
    got = predictor(networks, z, replace(SPEC, prediction_type=kind))(z, 999)
    assert got.dtype == np.float32
    # At pure noise α = 0 and σ = 1: v is −x0.
    np.testing.assert_array_equal(got, answer if kind == "v_prediction" else -answer)


def test_epsilon_at_zero_terminal_snr_is_refused_not_divided_by_zero(rng):
    z = rng.standard_normal(SHAPE, dtype=np.float32)
    networks, _ = knowing("epsilon", z, z)
    predict = predictor(networks, z, replace(SPEC, prediction_type="epsilon"))
    with pytest.raises(InvalidInputError, match="zero terminal SNR"):
        predict(z, 999)
    assert np.isfinite(predict(z, 998)).all()
