"""Models that are truncated, or change while a process uses them."""

import shutil

import pytest
from support.onnx_backbone import tiny_spec, write_backbone
from support.scenes import make_scene, make_shadow

from spotlight_runtime import Relighter
from spotlight_runtime.errors import ModelError, ModelIntegrityError

SCENE = make_scene(24, 32)
SHADOW = make_shadow(SCENE)
GRAPHS = ("vae_encoder", "condition_encoder", "denoiser", "vae_decoder")


@pytest.fixture
def model(backbone, tmp_path):
    return shutil.copytree(backbone, tmp_path / "tiny")


def relit(relighter):
    return relighter.relight(SCENE, SHADOW, denoise=False).image.tobytes()


@pytest.mark.parametrize("graph", GRAPHS)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_truncated_model(model, graph, share):
    path = model / f"{graph}.onnx"
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ModelIntegrityError, match=rf"{graph}\.onnx has \d+ bytes, expected"):
        Relighter.load(model, threads=1)
    with pytest.raises(ModelError, match=rf"{graph}\.onnx"):
        relit(Relighter.load(model, threads=1, verify_files=False))
    path.write_bytes(data)
    assert relit(Relighter.load(model, threads=1))


@pytest.mark.parametrize("graph", GRAPHS)
def test_byte_changed_without_a_trace_in_the_size(model, graph):
    path = model / f"{graph}.onnx"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(ModelIntegrityError, match=rf"{graph}\.onnx has sha256"):
        Relighter.load(model, threads=1)


def test_other_model_put_in_its_place_before_the_first_relight(model):
    """Sessions open when they are first used, which may be hours after the files were checked."""
    relighter = Relighter.load(model, threads=1)
    write_backbone(model, tiny_spec(steps=3), seed=7)
    with pytest.raises(ModelIntegrityError, match=r"changed since it was loaded.*Load the model"):
        relit(relighter)
    assert relit(Relighter.load(model, threads=1))


def test_other_model_put_in_its_place_between_relights(model):
    """Open sessions go on with what they have read; those that open anew notice."""
    kept = Relighter.load(model, threads=1, remember=0)
    frugal = Relighter.load(model, threads=1, remember=0, low_memory=True)
    before = relit(kept)
    assert relit(frugal) == before
    write_backbone(model, tiny_spec(steps=3), seed=7)
    assert relit(kept) == before
    with pytest.raises(ModelIntegrityError, match="changed since it was loaded"):
        relit(frugal)
    assert relit(Relighter.load(model, threads=1)) != before


def test_half_of_another_model_is_never_mixed_in(model):
    relighter = Relighter.load(model, threads=1, low_memory=True)
    other = write_backbone(model.with_name("other"), tiny_spec(steps=3), seed=7)
    run = relighter.run(SCENE, SHADOW, denoise=False)
    next(run)
    shutil.copy(other / "vae_decoder.onnx", model)
    with pytest.raises(ModelIntegrityError, match=r"vae_decoder\.onnx has sha256"):
        list(run)


def test_same_model_copied_over_itself_goes_on(model, backbone):
    relighter = Relighter.load(model, threads=1, low_memory=True)
    before = relit(relighter)
    for graph in GRAPHS:
        shutil.copy(backbone / f"{graph}.onnx", model)
    assert relit(relighter) == before


def test_model_that_is_gone(model):
    relighter = Relighter.load(model, threads=1)
    shutil.rmtree(model)
    with pytest.raises(ModelIntegrityError, match=r"denoiser\.onnx is missing"):
        relit(relighter)
