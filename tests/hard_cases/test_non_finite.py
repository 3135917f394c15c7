"""NaN and infinity are caught at the network that says them, with stage and step."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.onnx_backbone import tiny_spec
from support.scenes import make_scene, make_shadow

from spotlight_runtime import Relighter
from spotlight_runtime.composing.estimator import estimate_intrinsics
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.diffusion.sampler import sample
from spotlight_runtime.diffusion.schedule import Schedule
from spotlight_runtime.diffusion.solvers import make_solver
from spotlight_runtime.errors import NumericalError
from spotlight_runtime.imaging.denoise import denoise, denoiser_available
from spotlight_runtime.networks.models import predictor
from spotlight_spec import ScheduleSpec

from .relight_cases import tiny_relighter

BAD = [np.nan, np.inf, -np.inf]
STEPS = 4
TIMESTEPS = (999, 749, 499, 249)
AT = [rf"step {step} \(timestep {timestep}\)" for step, timestep in enumerate(TIMESTEPS)]
Network = Callable[..., dict[str, Any]]


def spoiled(network: Network, output: str, call: int, value: float) -> Network:
    """The network, but for one value of one output at one call."""
    calls = 0

    def run(**inputs: Any) -> dict[str, Any]:
        nonlocal calls
        outputs = {name: array.copy() for name, array in network(**inputs).items()}
        if calls == call:
            outputs[output].flat[-1] = value
        calls += 1
        return outputs

    return run


def relight_with(graph: str, output: str, call: int, value: float, **options: Any) -> None:
    healthy = tiny_relighter()
    networks = {name: healthy._networks[name] for name in healthy._networks}
    networks[graph] = spoiled(networks[graph], output, call, value)
    scene = make_scene(48, 64)
    lights = options.pop("lights", 1)
    shadows = [make_shadow(scene, side) for side in ("left", "right")][:lights]
    guide = shadows if lights > 1 else shadows[0]
    negative = None if lights > 1 else make_shadow(scene, "right")
    Relighter(healthy.spec, networks, remember=0).relight(
        scene, guide, negative, denoise=False, skip=False, **options
    )


def refused(message: str) -> Any:
    return pytest.raises(NumericalError, match="^" + message + r": 1 of \d+ values are NaN or inf")


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("branch", [0, 1])
@pytest.mark.parametrize("step", range(STEPS))
def test_denoiser_of_the_guided_pass(step: int, branch: int, value: float) -> None:
    """Branches are asked one after the other, so two calls are a step."""
    with refused(f"pass 'relight', {AT[step]}: the denoiser's prediction"):
        relight_with("denoiser", "prediction", 2 * step + branch, value)


@pytest.mark.parametrize("gamma", [1.0, 3.0])
@pytest.mark.parametrize("step", range(STEPS))
def test_denoiser_asked_for_both_branches_at_once(step: int, gamma: float) -> None:
    """Also at γ = 1, where the negative branch's prediction changes nothing."""
    with refused(f"pass 'relight', {AT[step]}: the denoiser's prediction"):
        relight_with("denoiser", "prediction", step, np.nan, batch_branches=True, gamma=gamma)


@pytest.mark.parametrize("step", range(STEPS))
def test_denoiser_of_the_pass_without_shadow(step: int) -> None:
    with refused(f"pass 'no shadow', {AT[step]}: the denoiser's prediction"):
        relight_with("denoiser", "prediction", 2 * STEPS + step, np.inf)


def test_second_of_two_lights() -> None:
    with refused(f"pass 'relight' of light 2, {AT[1]}: the denoiser's prediction"):
        relight_with("denoiser", "prediction", 2 * STEPS + 2, np.nan, lights=2)


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize(
    ("graph", "output", "call", "options", "message"),
    [
        ("vae_encoder", "latent_mean", 0, {}, "encoding the rough composite"),
        ("vae_encoder", "latent_mean", 1, {}, "encoding the rough composite"),
        (
            "vae_encoder",
            "latent_std",
            1,
            {"fidelity": "release"},
            r"encoding the rough composite \(its deviation\)",
        ),
        ("condition_encoder", "condition", 0, {}, r"encoding the conditioning \(branch 0\)"),
        ("condition_encoder", "condition", 1, {}, r"encoding the conditioning \(branch 1\)"),
        ("condition_encoder", "condition", 2, {}, r"encoding the conditioning \(branch 0\)"),
        ("vae_decoder", "image", 0, {}, "decoding the latents"),
        ("vae_decoder", "image", 1, {}, "decoding the latents"),
    ],
)
def test_networks_that_run_once(
    graph: str, output: str, call: int, options: dict, message: str, value: float
) -> None:
    with refused(message):
        relight_with(graph, output, call, value, **options)


def test_deviation_that_is_not_used_is_nobodys_error() -> None:
    relight_with("vae_encoder", "latent_std", 0, np.nan, fidelity="paper")


def finite(z: np.ndarray) -> np.ndarray:
    return np.tanh(z)


@pytest.mark.parametrize("kind", ["v_prediction", "epsilon", "sample"])
@pytest.mark.parametrize("value", BAD)
def test_prediction_is_caught_before_it_is_converted(kind: str, value: float) -> None:
    """An infinity minus an infinity would be a warning, and the error that of an innocent."""
    z = np.zeros((1, 4, 3, 5), np.float32)
    network = spoiled(lambda **_: {"prediction": finite(z)}, "prediction", 0, value)
    predict = predictor({"denoiser": network}, z, ScheduleSpec(prediction_type=kind))
    with refused("the denoiser's prediction"):
        predict(z, 499)


@pytest.mark.parametrize("output", ["down_0", "middle"])
def test_residuals_are_the_controlnets(output: str) -> None:
    """A UNet that clips would make finite numbers of them."""
    z = np.zeros((1, 4, 3, 5), np.float32)
    networks = {
        "controlnet": spoiled(lambda **_: {"down_0": z, "middle": z}, output, 1, np.nan),
        "unet": lambda **given: {"prediction": np.clip(given["latents"], -1.0, 1.0)},
    }
    predict = predictor(networks, z, ScheduleSpec())
    run = sample(predict, z, make_solver("ddim", Schedule.trailing(ScheduleSpec(), STEPS)))
    next(run)
    with refused(f"{AT[1]}: the controlnet's {output}"):
        next(run)


@pytest.mark.parametrize("solver", ["ddim", "dpmpp_2m", "unipc"])
def test_arithmetic_that_overflows_is_not_called_the_networks(solver: str) -> None:
    start = np.full((1, 4, 3, 5), 3e38, np.float32)

    def growing(z: np.ndarray, timestep: int) -> np.ndarray:
        return -np.abs(z)

    run = sample(growing, start, make_solver(solver, Schedule.trailing(ScheduleSpec(), STEPS)))
    with pytest.raises(NumericalError, match=r"^step \d \(timestep \d+\): the latents: .*lower"):
        list(run)


def test_guidance_that_overflows_is_called_so() -> None:
    both = np.concatenate([np.full((1, 4, 3, 5), sign * 3e38, np.float32) for sign in (1, -1)])
    solver = make_solver("ddim", Schedule.trailing(ScheduleSpec(), STEPS))
    run = sample(lambda z, t: both, both, solver, combine=lambda v: v[:1] + 2.0 * (v[:1] - v[1:]))
    with pytest.raises(NumericalError, match=f"^{AT[0]}: the guided prediction: 60"):
        next(run)


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("channel", range(7))
def test_estimator(channel: int, value: float) -> None:
    def network(image: np.ndarray) -> dict[str, np.ndarray]:
        maps = np.full((1, 7, *image.shape[2:]), 0.5, np.float32)
        maps[0, channel, 1, 2] = value
        return {"maps": maps}

    photograph = Photograph(np.full((64, 96, 3), 0.2, np.float32), name="attic.jpg")
    with refused(re.escape("attic.jpg: estimating the maps")):
        estimate_intrinsics(network, photograph)


@pytest.mark.skipif(not denoiser_available(), reason="needs Open Image Denoise")
@pytest.mark.parametrize("value", BAD)
def test_denoiser_of_pictures_hands_on_nothing_that_is_not_finite(value: float) -> None:
    """It mends such pixels by itself; the decoder's check is what says where they arose."""
    image = np.full((32, 32, 3), 0.5, np.float32)
    image[3, 4] = value
    assert np.isfinite(denoise(image)).all()


def test_a_network_of_zeros_is_no_error() -> None:
    """Black, constant, without any signal: finite all the same."""
    spec = tiny_spec()
    healthy = tiny_relighter()
    silent = {name: _silent(healthy._networks[name]) for name in healthy._networks}
    scene = make_scene(48, 64)
    result = Relighter(spec, silent, remember=0).relight(
        scene, make_shadow(scene), denoise=False, guidance_rescale=1.0, gamma=15.0
    )
    assert np.isfinite(result.image).all()


def _silent(network: Network) -> Network:
    return lambda **inputs: {k: np.zeros_like(v) for k, v in network(**inputs).items()}
