"""Open Image Denoise where it is installed, and what is said where it is not."""

import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from spotlight_runtime.errors import MissingExtraError
from spotlight_runtime.imaging.denoise import denoise, denoiser_available

installed = pytest.mark.skipif(not denoiser_available(), reason="needs the extra 'denoise'")


@pytest.fixture(scope="module")
def noisy():
    ramp = np.linspace(0.1, 0.7, 64, dtype=np.float32)
    clean = np.broadcast_to(ramp[None, :, None], (48, 64, 3)).copy()
    noise = np.random.default_rng(0).normal(0.0, 0.08, clean.shape)
    return clean, np.clip(clean + noise, 0.0, 1.0).astype(np.float32)


@installed
@pytest.mark.parametrize("auxiliaries", [[], ["albedo"], ["albedo", "normal"], ["normal"]])
def test_noise_goes(noisy, auxiliaries):
    clean, image = noisy
    maps = {"albedo": clean, "normal": np.full_like(clean, 0.5)}
    got = denoise(image, **{name: maps[name] for name in auxiliaries})
    assert got.shape == image.shape
    assert got.dtype == np.float32
    assert 0.0 <= got.min() <= got.max() <= 1.0
    assert np.abs(got - clean).mean() < 0.5 * np.abs(image - clean).mean()


@installed
def test_same_picture_same_bytes_in_any_layout(noisy):
    _, image = noisy
    wanted = denoise(image)
    assert denoise(image).tobytes() == wanted.tobytes()
    assert denoise(np.asfortranarray(image)).tobytes() == wanted.tobytes()


@installed
def test_noisy_backbone_is_denoised_by_default(relighter, options, scene, shadow):
    chosen = replace(options, denoise=None, steps=1)
    result = relighter.relight(scene, shadow, options=chosen)
    assert result.denoised == "on"
    assert "denoise" in result.timings
    raw = relighter.relight(scene, shadow, options=replace(chosen, denoise=False))
    assert (
        np.abs(np.diff(result.prediction, axis=1)).mean()
        < np.abs(np.diff(raw.prediction, axis=1)).mean()
    )
    assert same(result, relighter.relight(scene, shadow, options=replace(chosen, denoise=True)))


def same(a, b):
    return a.image.tobytes() == b.image.tobytes()


@installed
def test_threads_denoise_the_same(noisy):
    _, image = noisy
    wanted = denoise(image).tobytes()
    with ThreadPoolExecutor(4) as pool:
        assert {d.tobytes() for d in pool.map(denoise, [image] * 8)} == {wanted}


@pytest.fixture
def not_installed(monkeypatch):
    """What an environment without the extra looks like to importlib."""
    monkeypatch.setitem(sys.modules, "pyoidn", None)


def test_missing_extra_names_the_pip_command(not_installed):
    assert not denoiser_available()
    with pytest.raises(MissingExtraError, match=r"pip install 'spotlight-relight\[denoise\]'"):
        denoise(np.zeros((8, 8, 3), np.float32))


def test_without_the_extra_a_noisy_backbone_says_so(
    not_installed, relighter, options, scene, shadow
):
    chosen = replace(options, denoise=None, steps=1)
    result = relighter.relight(scene, shadow, options=chosen)
    assert "not installed" in result.denoised
    run = relighter.run(scene, shadow, options=replace(chosen, denoise=True))
    with pytest.raises(MissingExtraError, match="pip install"):
        next(run)  # before the first step, not after the last


@installed
def test_denoising_does_not_bring_torch_along():
    script = """
        import sys
        import numpy as np
        from spotlight_runtime.imaging.denoise import denoise

        denoise(np.zeros((16, 16, 3), np.float32))
        assert "torch" not in sys.modules, sorted(sys.modules)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=True)


@installed
def test_module_of_that_name_is_not_hidden_from_others(noisy, monkeypatch):
    stand_in = SimpleNamespace()
    monkeypatch.setitem(sys.modules, "torch", stand_in)
    denoise(noisy[1])
    assert sys.modules["torch"] is stand_in


@installed
def test_torch_that_is_already_there_stays():
    script = """
        import sys, types
        import numpy as np
        torch = sys.modules["torch"] = types.ModuleType("torch")
        from spotlight_runtime.imaging.denoise import denoise

        denoise(np.zeros((16, 16, 3), np.float32))
        assert sys.modules["torch"] is torch
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=True)
