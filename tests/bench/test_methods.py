"""Choosing methods by name."""

import pytest

from spotlight_bench.errors import MethodError
from spotlight_bench.methods import BUILT_IN, OURS, QUICK, choose
from spotlight_runtime.planning.ladder import Rung, named_rung


def test_all_the_papers_variants_are_there():
    settings = {(m.gamma, m.beta, m.negative) for m in BUILT_IN.values() if m.kind == "spotlight"}
    assert settings == {
        (3.0, 0.05, "opposite"),
        (1.0, 0.05, "opposite"),
        (7.0, 0.05, "opposite"),
        (3.0, 0.0, "opposite"),
        (3.0, 0.2, "opposite"),
        (3.0, 0.05, "none"),
    }
    assert {"pasted", "no-control", "sdedit", OURS} <= set(QUICK) <= set(BUILT_IN)
    assert {m.plan for m in BUILT_IN.values()} == {"exact", "balanced", "draft"}


def test_tables_keep_their_order_and_folders_come_last(tmp_path):
    chosen = choose([OURS, "pasted"], [f"gaffer={tmp_path}"])
    assert [m.name for m in chosen] == ["pasted", OURS, "gaffer"]
    assert chosen[-1].kind == "folder"
    assert str(tmp_path) in chosen[-1].how


def test_settings_tell_methods_apart():
    assert len({m.how for m in BUILT_IN.values()}) == len(BUILT_IN)


def test_results_of_a_plan_are_not_kept_when_the_plan_becomes_another(monkeypatch):
    draft = BUILT_IN["draft"].how
    options = named_rung("draft").options
    assert all(repr(value).replace("'", '"') in draft for value in options.values())
    other = Rung("draft", options | {"steps": 17}, None)
    monkeypatch.setattr("spotlight_bench.methods.named_rung", lambda name, reusable: other)
    assert BUILT_IN["draft"].how != draft


@pytest.mark.parametrize(
    "entry", ["gaffer", "=x", "gaffer=", "a/b=x", ".hidden=x", "gaffer=/no/such"]
)
def test_a_folder_that_is_none_is_named(entry):
    with pytest.raises(MethodError, match="expected"):
        choose([OURS], [entry])


def test_unknown_and_taken_names_are_named(tmp_path):
    with pytest.raises(MethodError, match=r"got gama-1.*--method"):
        choose(["gama-1"])
    with pytest.raises(MethodError, match="taken"):
        choose([OURS], [f"sdedit={tmp_path}"])
    with pytest.raises(MethodError, match="taken"):
        choose([OURS], [f"a={tmp_path}", f"a={tmp_path}"])
    with pytest.raises(MethodError, match="at least one"):
        choose([])
