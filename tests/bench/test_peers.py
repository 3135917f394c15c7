"""Engines beside ours: the same numbers from the same graphs, each in a process of its own."""

from dataclasses import asdict
from importlib.util import find_spec

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from spotlight_bench.arguments import names
from spotlight_bench.peers import Measured, Peer, PeerError, among, measure, rows
from spotlight_bench.peers_command import peers
from spotlight_bench.peers_engines import open_engine
from spotlight_bench.peers_worker import evaluations, relight, scene_of
from spotlight_spec import Manifest

needs_openvino = pytest.mark.skipif(find_spec("openvino") is None, reason="needs OpenVINO")


def test_scene_has_two_shadows_beside_the_object():
    scene, guide = scene_of(64)
    assert scene.object_mask.sum() > 100
    for shadow in (guide.positive, guide.negative):
        assert shadow.sum() > 50
        assert (shadow * scene.object_mask).max() == 0.0
    np.testing.assert_array_equal(guide.positive, guide.negative[:, ::-1])


@pytest.mark.parametrize(
    ("engine", "precision", "tolerance"),
    [
        ("onnxruntime", "fp32", 1e-5),
        pytest.param("openvino", "fp32", 1e-5, marks=needs_openvino),
        pytest.param("openvino", "bf16", 3e-2, marks=needs_openvino),
        pytest.param("spotlight", "openvino-bf16", 3e-2, marks=needs_openvino),
    ],
)
def test_engines_give_what_ours_does(backbone_folder, engine, precision, tolerance):
    spec = Manifest.read(backbone_folder).backbone
    ours = open_engine("spotlight", backbone_folder, "own", 1)
    other = open_engine(engine, backbone_folder, precision, 1)
    want, seconds = evaluations(ours, spec, 64, 4)
    got, _ = evaluations(other, spec, 64, 4)
    assert len(seconds) == 4
    assert want.shape == (3, spec.latent.channels, 8, 8)
    assert np.linalg.norm(got - want) <= tolerance * np.linalg.norm(want)
    _, made = relight(other, spec, 64, "release", ours=False, batched=False)
    _, same = relight(ours, spec, 64, "release", ours=True, batched=False)
    assert made.evaluations == same.evaluations == 3 * spec.schedule.steps
    picture, expected = made.prediction, same.prediction
    assert np.linalg.norm(picture - expected) <= 2 * tolerance * np.linalg.norm(expected)


@pytest.fixture(scope="module")
def pair(backbone_folder):
    return (
        Peer("plain", "plain", "onnxruntime", backbone_folder),
        Peer("ours", "ours", "spotlight", backbone_folder, "own", ("release", "draft")),
    )


def test_peers_are_chosen_by_name(pair):
    assert among(pair, ()) == pair
    assert among(pair, ["ours"]) == pair[1:]
    with pytest.raises(PeerError, match="expected some of plain, ours, got theirs"):
        among(pair, names("ours, theirs"))
    with pytest.raises(PeerError, match="expected one of ours among plain"):
        among(pair, ["plain"])


def test_a_round_measures_every_peer_in_its_own_process(pair, backbone_folder, tmp_path):
    found = list(
        measure(
            pair, backbone_folder, tmp_path, side=64, threads=1, rounds=1, relights=1, evaluations=3
        )
    )
    assert [one.peer for one in found] == ["plain", "ours"]
    assert all(one.peak_memory_bytes > 10_000_000 for one in found)
    plain, exact, draft = rows(pair, found, tmp_path)
    assert (plain.evaluation_error, plain.relight_error) == (0.0, 0.0)
    assert exact.evaluation_error <= 1e-5
    assert exact.times_ours == 1.0
    assert (exact.plan, draft.plan) == ("release", "draft")
    # Both branches of two steps, and the picture without a shadow in two, of the draft in one.
    assert (plain.evaluations, exact.evaluations, draft.evaluations) == (6, 6, 5)
    assert asdict(draft)["relight_seconds"] > 0.0


def test_ratios_are_of_the_same_round(pair, tmp_path):
    for peer in pair:
        (tmp_path / peer.name).mkdir()
        for name in ("predictions", "relight_release", "relight_draft"):
            np.save(tmp_path / peer.name / f"{name}.npy", np.ones(3))
    found = [
        Measured(number, name, [slow * each], {"release": slow * 9 * each, "draft": slow}, {
            "release": 6, "draft": 2}, 0.1, None)
        for number, slow in enumerate((1.0, 30.0))
        for name, each in (("plain", 2.0), ("ours", 1.0))
    ]  # fmt: skip
    plain, *_ = rows(pair, found, tmp_path)
    assert plain.times_ours == 2.0
    assert plain.relight_times_ours == 2.0
    assert plain.peak_memory_bytes is None


def test_evaluations_alone_say_nothing_of_relights(pair, backbone_folder, tmp_path):
    asked = {"side": 64, "threads": 1, "rounds": 1, "relights": 0, "evaluations": 3}
    found = list(measure(pair, backbone_folder, tmp_path, **asked))
    plain, ours = rows(pair, found, tmp_path)
    assert ours.times_ours == 1.0
    for row in (plain, ours):
        assert row.plan == ""
        assert row.evaluations is row.relight_seconds is row.relight_error is None


def test_a_peer_that_fails_is_named(pair, backbone_folder, tmp_path):
    broken = Peer("gone", "no such graphs", "onnxruntime", tmp_path / "nowhere")
    wish = {"side": 64, "threads": 1, "rounds": 1, "relights": 0, "evaluations": 1}
    with pytest.raises(PeerError, match="peer no such graphs: KeyError: 'denoiser'"):
        next(measure((broken, *pair), backbone_folder, tmp_path, **wish))


@pytest.mark.full
def test_a_tiny_checkpoint_goes_through_all_engines(tmp_path):
    app = typer.Typer()
    app.command()(peers)
    given = ["--size", "tiny", "--quick", "-o", str(tmp_path), "--threads", "1", "--ours", "fp32"]
    outcome = CliRunner().invoke(app, given)
    assert outcome.exception is None, outcome.output
    text = (tmp_path / "peers.md").read_text()
    for label in ("diffusers fp32", "diffusers bf16", "plain export, ONNX Runtime", "SpotLight"):
        assert f"| {label}" in text
