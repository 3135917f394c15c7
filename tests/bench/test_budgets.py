"""Predictions against the clock: what is drawn, what is counted, a few requests run."""

import json

import pytest
import typer
from typer.testing import CliRunner

from spotlight_bench.budgets import Outcome, Request, budgets, draw, summary
from spotlight_runtime.planning.options import RelightOptions

ANY = Request("room", ("0000",), "budget", {})


def test_requests_are_seeded_valid_and_of_every_kind():
    drawn = draw(200, ["a", "b"], [f"{n:04d}" for n in range(8)], seed=3)
    assert drawn == draw(200, ["a", "b"], [f"{n:04d}" for n in range(8)], seed=3)
    assert {each.kind for each in drawn} == {"budget", "plan", "options"}
    assert {len(each.lights) for each in drawn} == {1, 2, 3}
    for each in drawn:
        assert len(set(each.lights)) == len(each.lights)
        RelightOptions(**{k: v for k, v in each.wishes.items() if k not in ("budget", "plan")})


def test_shares_and_the_worst_overrun():
    found = [
        Outcome(ANY, "balanced", 1.0, 1.1, 1.05),
        Outcome(ANY, "draft", 1.0, 0.7, 1.0),
        Outcome(ANY, "exact", 1.0, 1.5, None),
        Outcome(ANY, "refused", None, None, 0.1),
    ]
    facts = summary(found)
    assert facts["requests"] == 4
    assert facts["refused"] == 1
    assert facts["within_20_percent"] == pytest.approx(1 / 3)
    assert facts["largest_error"] == pytest.approx(0.5)
    assert facts["worst_overrun"] == pytest.approx(1.1 / 1.05 - 1)
    assert not facts["predictions_hold"]
    assert facts["budgets_hold"]


def test_a_run_says_how_far_off_every_request_was(backbone_folder, testset, tmp_path):
    app = typer.Typer()
    app.command()(budgets)
    given = [str(testset), "--model", str(backbone_folder), "--requests", "12", "--threads", "1"]
    outcome = CliRunner(env={"XDG_CACHE_HOME": str(tmp_path)}).invoke(
        app, [*given, "--json", str(tmp_path / "all.json")]
    )
    assert outcome.exception is None, outcome.output
    assert "within 20 percent:" in outcome.output
    found = json.loads((tmp_path / "all.json").read_text())
    assert found["summary"]["requests"] == len(found["outcomes"]) == 12
    for one in found["outcomes"]:
        if one["plan"] == "refused":
            assert one["budget"] > 0.0
            continue
        assert one["error"] == pytest.approx(one["actual"] / one["predicted"] - 1.0)
        if one["budget"] is not None:
            assert one["predicted"] <= one["budget"]
