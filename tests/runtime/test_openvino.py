"""The graphs on OpenVINO: the same pictures, the same errors."""

import sys

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow

from runtime.small_graphs import contract, tensor, write_product
from spotlight_runtime import Relighter
from spotlight_runtime.errors import (
    GraphContractError,
    InvalidInputError,
    MissingExtraError,
    ModelError,
)
from spotlight_runtime.networks.models import resolve_model
from spotlight_runtime.networks.openvino import computes_indices, open_graph

ONES = np.ones((1, 4, 2, 3), np.float32)


def test_without_it_the_error_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "openvino", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'spotlight-relight\[openvino\]'"):
        open_graph(write_product(tmp_path), contract(), precision="f32")


def test_there_are_no_other_engines(backbone):
    with pytest.raises(InvalidInputError, match="engine: expected onnxruntime, openvino"):
        Relighter.load(backbone, engine="tensorflow")


class TestWithIt:
    @pytest.fixture(autouse=True)
    def installed(self):
        pytest.importorskip("openvino", reason="needs the extra openvino")

    def test_graph_is_a_function_of_named_arrays(self, tmp_path):
        graph = open_graph(write_product(tmp_path), contract(), precision="f32", threads=1)
        for shape in ((1, 4, 2, 3), (2, 4, 5, 1)):
            ones = np.ones(shape, np.float32)
            got = graph(x=2.0 * ones, y=3.0 * ones)
            assert list(got) == ["product"]
            np.testing.assert_array_equal(got["product"], 6.0 * ones)

    def test_a_size_gives_the_same_whatever_was_asked_before(self, backbone):
        folder = resolve_model(backbone)
        sizes = folder.manifest.backbone.own_sizes | {"height": 64, "width": 64}
        contract = folder.manifest.graph("vae_encoder")
        rng = np.random.default_rng(0)
        own, other = (rng.random((1, 3, 64, width), np.float32) for width in (64, 96))

        def opened(**sizes):
            return open_graph(folder.path, contract, precision="bf16", threads=1, **sizes)

        one, two = opened(sizes=sizes), opened(sizes=sizes)
        first, then = one(image=own), one(image=other)
        np.testing.assert_array_equal(two(image=other)["latent_mean"], then["latent_mean"])
        np.testing.assert_array_equal(two(image=own)["latent_mean"], first["latent_mean"])
        any_size = opened()(image=own)["latent_mean"]
        np.testing.assert_allclose(first["latent_mean"], any_size, atol=0.05)

    def test_what_a_graph_is_not_is_said(self, tmp_path):
        folder = write_product(tmp_path)
        with pytest.raises(InvalidInputError, match="threads: expected 1 or more, got 0"):
            open_graph(folder, contract(), precision="f32", threads=0)
        other = contract(outputs=(tensor("sum"),))
        with pytest.raises(GraphContractError, match=r"expected tensors \['sum'\]"):
            open_graph(folder, other, precision="f32")
        with pytest.raises(ModelError, match="cannot be run on x float32"):
            open_graph(folder, contract(), precision="f32")(x=ONES, y=ONES[..., :2])
        (folder / contract().file_name).write_bytes(b"no graph")
        with pytest.raises(ModelError, match="OpenVINO cannot load the graph"):
            open_graph(folder, contract(), precision="f32")

    @pytest.mark.parametrize(("engine", "allowed"), [("openvino", 1e-4), ("openvino-bf16", 0.05)])
    def test_a_relight_is_the_same(
        self, backbone, relighter, options, engine, allowed, scene, shadow
    ):
        other = Relighter.load(backbone, engine=engine, threads=1, remember=0)
        wanted = relighter.relight(scene, shadow, options=options)
        made = other.relight(scene, shadow, options=options)
        difference = np.abs(made.image - wanted.image)
        assert difference.max() <= 4 * allowed
        assert difference.mean() <= allowed
        assert made.report()["model"]["engine"] == engine

    def test_places_to_read_at_are_not_rounded(self):
        """Bfloat16 counts to 256; the mini's condition encoder looks up any of its latents."""
        import openvino as ov

        folder = resolve_model("mini")
        names = [contract.name for contract in folder.manifest.graphs]
        read = {name: ov.Core().read_model(folder.path / f"{name}.onnx") for name in names}
        assert [n for n in names if computes_indices(read[n])] == ["condition_encoder"]
        maps = np.random.default_rng(0).random((1, 13, 256, 256), np.float32)
        exact, rounded = (
            open_graph(
                folder.path,
                folder.manifest.graph("condition_encoder"),
                precision=precision,
                threads=1,
            )(conditioning=maps)["condition"]
            for precision in ("f32", "bf16")
        )
        np.testing.assert_array_equal(rounded, exact)

    def test_the_embedded_model_runs_in_bfloat16(self, options):
        scene = make_scene(256, 256)
        shadow = make_shadow(scene)
        wanted, made = (
            Relighter.load("mini", engine=engine, threads=1, remember=0).relight(
                scene, shadow, options=options, steps=2
            )
            for engine in ("onnxruntime", "openvino-bf16")
        )
        assert np.abs(made.image - wanted.image).mean() <= 0.05
