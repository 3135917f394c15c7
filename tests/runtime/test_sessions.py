"""ONNX Runtime sessions: threads, providers, and graphs that are not what their contract says."""

import os
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from runtime.small_graphs import contract, tensor, write_product
from spotlight_runtime.errors import (
    GraphContractError,
    InvalidInputError,
    ModelError,
    ProviderError,
    SpotLightError,
)
from spotlight_runtime.networks.sessions import (
    OnnxGraph,
    available_cpus,
    open_graph,
    runtime_version,
)

ONES = np.ones((1, 4, 2, 3), np.float32)


@pytest.fixture
def affinity():
    return len(os.sched_getaffinity(0))


@pytest.mark.parametrize(
    ("text", "cpus"),
    [("150000 100000", 2), ("100000 100000", 1), ("10000 100000", 1), ("99999900000 100000", None)],
)
def test_cgroup_v2_quota(tmp_path, affinity, text, cpus):
    (tmp_path / "cpu.max").write_text(f"{text}\n")
    assert available_cpus(tmp_path) == min(affinity, cpus or affinity)


@pytest.mark.parametrize(("quota", "cpus"), [("150000", 2), ("50000", 1), ("-1", None)])
def test_cgroup_v1_quota(tmp_path, affinity, quota, cpus):
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu/cpu.cfs_quota_us").write_text(quota)
    (tmp_path / "cpu/cpu.cfs_period_us").write_text("100000")
    assert available_cpus(tmp_path) == min(affinity, cpus or affinity)


@pytest.mark.parametrize("text", ["max 100000", "", "nonsense", "1 2 3", "100000 0", "0 100000"])
def test_unlimited_or_unreadable_quota_leaves_the_affinity(tmp_path, affinity, text):
    (tmp_path / "cpu.max").write_text(text)
    assert available_cpus(tmp_path) == affinity


def test_no_cgroup_leaves_the_affinity(tmp_path, affinity):
    assert available_cpus(tmp_path) == affinity
    assert 1 <= available_cpus() <= affinity


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs CPU affinity")
def test_affinity_limits(tmp_path):
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        assert available_cpus(tmp_path) == 1
    finally:
        os.sched_setaffinity(0, allowed)


def test_graph_is_a_function_of_named_arrays(tmp_path):
    graph = open_graph(write_product(tmp_path), contract(), threads=1)
    got = graph(x=2.0 * ONES, y=3.0 * ONES)
    assert list(got) == ["product"]
    np.testing.assert_array_equal(got["product"], 6.0 * ONES)


@pytest.mark.parametrize("threads", [None, 1, 3])
def test_threads(tmp_path, threads):
    graph = open_graph(write_product(tmp_path), contract(), threads=threads)
    wanted = threads or available_cpus()
    assert graph._session.get_session_options().intra_op_num_threads == wanted


@pytest.mark.parametrize("threads", [0, -1])
def test_no_threads_is_an_error_not_a_default(tmp_path, threads):
    with pytest.raises(InvalidInputError, match=f"threads: expected 1 or more, got {threads}"):
        open_graph(write_product(tmp_path), contract(), threads=threads)


TINY = np.float32(1e-20)


def underflow(graph):
    """1e-20 · 1e-20 is a denormal."""
    return graph(x=TINY * ONES, y=TINY * ONES)["product"]


@pytest.mark.skipif(sys.platform != "linux", reason="the calling thread flushes on Linux only")
def test_denormals_are_zero_whichever_thread_runs_the_graph(tmp_path):
    graph = open_graph(write_product(tmp_path), contract(), threads=1)
    assert not underflow(graph).any()
    with ThreadPoolExecutor(1) as pool:
        assert not pool.submit(underflow, graph).result().any()


def test_denormals_are_kept_everywhere_else(tmp_path):
    """In a process of its own: ONNX Runtime touches the thread that opens the first session."""
    script = """
        import sys
        from pathlib import Path
        import numpy as np
        from runtime.small_graphs import contract, write_product
        from runtime.test_sessions import ONES, TINY, underflow
        from spotlight_runtime.errors import ModelError
        from spotlight_runtime.networks.sessions import open_graph

        def kept():
            assert TINY * TINY > 0.0
            assert float(np.nextafter(0.0, 1.0)) == 5e-324
            np.finfo(np.float64).smallest_subnormal  # numpy warns where denormals are flushed

        graph = open_graph(write_product(Path(sys.argv[1])), contract())
        kept()
        underflow(graph)
        kept()
        try:
            graph(x=ONES)
        except ModelError:
            kept()
    """
    tests = str(Path(__file__).parents[1])
    subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(script), str(tmp_path)],
        check=True,
        env=os.environ | {"PYTHONPATH": tests},
    )


@pytest.mark.parametrize(
    ("expected", "present"),
    [
        (contract(inputs=[tensor("y"), tensor("x")]), {}),
        (contract(inputs=[tensor("x")]), {}),
        (contract(inputs=[tensor("x"), tensor("y"), tensor("z")]), {}),
        (contract(outputs=[tensor("prediction")]), {}),
        (contract(), {"names": ("x", "z", "product")}),
        (contract(), {"dtype": "int64"}),
        (contract(), {"dtype": "double"}),
        (contract(), {"shape": ("batch", 8, "h", "w")}),
        (contract(), {"shape": ("batch", 4, "h")}),
        (contract(), {"shape": ("batch", 4, "h", "w", "d")}),
        (contract(), {"shape": (1, 4, "h", "w")}),
        (contract(), {"shape": ("batch", 4, 64, 64)}),
    ],
    ids=[
        "order",
        "too many inputs",
        "missing input",
        "output name",
        "input name",
        "integers",
        "doubles",
        "channels",
        "lower rank",
        "higher rank",
        "baked batch",
        "baked size",
    ],
)
def test_graph_that_breaks_its_contract_is_named(tmp_path, expected, present):
    write_product(tmp_path, **present)
    with pytest.raises(GraphContractError, match=r"unet\.onnx: .*export the model again"):
        open_graph(tmp_path, expected, threads=1)


def test_names_of_dynamic_dimensions_are_free(tmp_path):
    write_product(tmp_path, shape=("n", 4, "8*h", None))
    open_graph(tmp_path, contract(), threads=1)


def test_what_the_graph_cannot_take_is_a_model_error_with_the_shapes(tmp_path):
    graph = open_graph(write_product(tmp_path), contract(), threads=1)
    with pytest.raises(ModelError, match=r"unet\.onnx: .*float32\[1, 5, 2, 3\]"):
        graph(x=np.ones((1, 5, 2, 3), np.float32), y=ONES)
    with pytest.raises(ModelError, match="float64"):
        graph(x=ONES.astype(np.float64), y=ONES)


@pytest.mark.parametrize("data", [None, b"", b"\0" * 100, b"not a graph"])
def test_file_that_is_no_graph_is_named(tmp_path, data):
    if data is not None:
        (tmp_path / "unet.onnx").write_bytes(data)
    with pytest.raises(ModelError, match=r"unet\.onnx: ONNX Runtime cannot load"):
        open_graph(tmp_path, contract(), threads=1)


def test_truncated_graph_is_an_error_of_the_tree(tmp_path):
    data = (write_product(tmp_path) / "unet.onnx").read_bytes()
    for keep in range(0, len(data), 7):
        (tmp_path / "unet.onnx").write_bytes(data[:keep])
        with pytest.raises(SpotLightError, match=r"unet\.onnx"):
            open_graph(tmp_path, contract(), threads=1)


def test_provider_that_is_not_installed_is_named_with_those_that_are(tmp_path):
    write_product(tmp_path)
    with pytest.raises(ProviderError, match=r"NoSuchProvider is not installed.*CPUExecution"):
        open_graph(tmp_path, contract(), providers=["NoSuchProvider", "CPUExecutionProvider"])


@pytest.mark.parametrize("providers", [[], (), "CPUExecutionProvider"])
def test_providers_are_a_list_of_names(tmp_path, providers):
    with pytest.raises(InvalidInputError, match=r"^providers: expected a list .*, got ") as caught:
        open_graph(write_product(tmp_path), contract(), providers=providers)
    assert repr(providers) in str(caught.value)


def test_the_version_is_the_modules_whatever_its_distribution_is_called(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", SimpleNamespace(__version__="1.2.3"))
    assert runtime_version() == "1.2.3"


def test_provider_that_steps_back_is_an_error(tmp_path, monkeypatch):
    """ONNX Runtime falls back with a log line; here that is not what was asked for."""

    class Session:
        def __init__(self, path, options, providers):
            pass

        def get_providers(self):
            return ["CPUExecutionProvider"]

    installed = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    options = SimpleNamespace(add_session_config_entry=lambda key, value: None)
    fake = SimpleNamespace(
        get_available_providers=lambda: installed,
        SessionOptions=lambda: options,
        InferenceSession=Session,
    )
    monkeypatch.setitem(sys.modules, "onnxruntime", fake)
    with pytest.raises(ProviderError, match=r"asked for CUDA.*in use is CPUExecutionProvider"):
        open_graph(tmp_path, contract(), providers=["CUDAExecutionProvider"])


def test_injected_session_needs_only_four_methods():
    """What a fake must be to stand behind a contract."""

    class Doubler:
        def get_inputs(self):
            return [SimpleNamespace(name="x", type="tensor(float)", shape=["n", 4, None, "w"])]

        def get_outputs(self):
            return [SimpleNamespace(name="product", type="tensor(float)", shape=["n", 4, "h", "w"])]

        def run(self, names, inputs):
            assert names == ["product"]
            return [2.0 * inputs["x"]]

    graph = OnnxGraph(Doubler(), contract(inputs=[tensor("x")]))
    np.testing.assert_array_equal(graph(x=ONES)["product"], 2.0 * ONES)
