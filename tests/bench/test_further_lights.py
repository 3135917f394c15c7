"""What a second light adds: how shares are counted, and a few rounds run."""

import json

import pytest
import typer
from typer.testing import CliRunner

from spotlight_bench.further_lights import Round, further_lights, shares


def test_shares_are_of_the_same_rounds_first_light():
    found = [
        Round("room", "exact", 1.0, 0.7, 1.5),
        Round("room", "exact", 2.0, 1.0, 3.2),
        Round("room", "exact", 4.0, 2.4, 6.0),
    ]
    assert shares(found) == pytest.approx({"first": 2.0, "later": 0.6, "together": 0.5})


def test_a_run_measures_every_plan(backbone_folder, testset, tmp_path):
    app = typer.Typer()
    app.command()(further_lights)
    given = [str(testset), "--model", str(backbone_folder), "--rounds", "2", "--threads", "1"]
    outcome = CliRunner(env={"XDG_CACHE_HOME": str(tmp_path)}).invoke(
        app, [*given, "--json", str(tmp_path / "all.json")]
    )
    assert outcome.exception is None, outcome.output
    assert "in the same request, at most 60%:" in outcome.output
    found = json.loads((tmp_path / "all.json").read_text())
    assert set(found["shares"]) == {"exact", "balanced", "draft"}
    assert len(found["rounds"]) == 6
    for one in found["rounds"]:
        assert min(one["first"], one["later"]) > 0.0
        assert one["both"] > 0.0
