"""The curve: what is swept, what is scored, the front, the ladder, and a whole run."""

import csv
import json
import shutil
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from support.onnx_backbone import tiny_spec, write_backbone
from typer.testing import CliRunner

from spotlight_bench import metrics
from spotlight_bench.errors import ResultsError
from spotlight_bench.pareto import directions_of, psnr
from spotlight_bench.pareto_command import pareto
from spotlight_bench.pareto_grid import EXACT, FULL, QUICK, Candidate, Grid, candidates
from spotlight_bench.pareto_ladder import (
    BALANCED_SHARE,
    DRAFT_SHARE,
    claims,
    ladder_record,
    name_rungs,
)
from spotlight_bench.pareto_summary import Point, front, points, survivors
from spotlight_bench.pareto_timing import Timing
from spotlight_bench.results import Result
from spotlight_bench.statistics import Estimate
from spotlight_runtime import RelightOptions
from spotlight_runtime.planning.ladder import read_ladder


def point(share, fidelity, name="saving", loss=0.0, model="mini"):
    options = {} if name == EXACT else {"steps": 1 + int(1000 * share)}
    same = Estimate(fidelity, fidelity, fidelity, 3)
    lost = Estimate(loss, loss, loss, 3)
    return Point(
        Candidate(name, options, model),
        60 * share,
        share,
        {"exact_object_psnr": same, "exact_rest_psnr": Estimate(99.0, 99.0, 99.0, 3)},
        {"object_psnr": lost, "within_45": lost},
    )


shares = st.floats(0.02, 0.99).map(lambda value: round(value, 3))
savings = st.lists(
    st.tuples(shares, st.integers(150, 600)), min_size=1, max_size=25, unique_by=lambda s: s[0]
)


def swept(drawn):
    made = [point(share, tenths / 10, f"s{share}") for share, tenths in drawn]
    return front([point(1.0, 100.0, EXACT), *made])


@pytest.mark.parametrize("grid", [FULL, QUICK])
def test_candidates_are_valid_options_and_each_a_plan_of_its_own(grid):
    found = candidates(grid, 20, ("mini", "mini-int8"), ("mini", "mini-int8"))
    assert found[0] == Candidate(EXACT, {}, "mini")
    assert len({each.name for each in found}) == len(found)
    plans = set()
    for each in found:
        options = each.apply(RelightOptions())
        steps = options.steps or 20
        guided = tuple(round(end * steps) for end in options.guidance_interval)
        assert guided[0] < guided[1]
        key = (each.model, options.solver, steps, guided, options.plain_steps or steps)
        plans.add((*key, options.window, options.reuse))
    assert len(plans) == len(found)
    assert sum(each.model == "mini" for each in found) == len(found) / 2


def test_only_models_that_share_features_between_steps():
    found = candidates(QUICK, 20, ("mini", "plain"), ("mini",))
    sharing = [each for each in found if each.options.get("reuse", 1) > 1]
    assert {each.model for each in sharing} == {"mini"}
    names = {each.name: each.options for each in sharing}
    assert names["unipc-12-p6-r3"]["reuse"] == 3
    assert names["ddim-2-r2"]["reuse"] == 2, "no more than there are steps"
    assert not any("guidance_interval" in options for options in names.values())


def test_a_grid_beyond_the_backbones_own_steps_is_cut():
    grid = Grid(("ddim",), (20, 2), ((0.0, 1.0),), (1.0,), ("auto",))
    assert [each.name for each in candidates(grid, 20, ("m",))] == [EXACT, "ddim-2"]
    assert [each.name for each in candidates(grid, 2, ("m",))] == [EXACT]


@given(st.integers(1, 8))
def test_every_azimuth_has_its_turn(azimuths):
    scenes = [directions_of(index, azimuths) for index in range(8)]
    assert all(names[0] == "gt_dir" and len(set(names)) == azimuths + 1 for names in scenes)
    counts = [sum(f"{number:04d}" in names for names in scenes) for number in range(8)]
    assert counts == [azimuths] * 8


def test_psnr_is_the_evaluations_own():
    rng = np.random.default_rng(0)
    truth = rng.random((32, 32, 3), np.float32)
    picture = np.clip(truth + rng.normal(0, 0.05, truth.shape).astype(np.float32), 0, 1)
    masks = metrics.regions((rng.random((32, 32)) > 0.6).astype(np.float32))
    views = metrics.isolated(picture, truth, masks)
    wanted = metrics.scores(views, truth, masks, {})
    for name in ("foreground", "background"):
        assert psnr(picture, truth, masks[name]) == wanted[name]["psnr"]
    assert psnr(truth, truth, masks["foreground"]) == metrics.BEST_PSNR
    assert psnr(truth, truth, np.zeros((32, 32), bool)) is None


@given(savings)
def test_nothing_on_the_front_is_beaten_and_all_else_is(drawn):
    found = swept(drawn)

    def beaten_by(one, other):
        return (
            other.cost <= one.cost
            and other.fidelity >= one.fidelity
            and (other.cost, other.fidelity) != (one.cost, one.fidelity)
        )

    for each in found:
        assert each.front != any(beaten_by(each, other) for other in found)
        if not each.front:
            assert any(beaten_by(each, other) for other in found if other.front)


@given(savings)
def test_the_screening_keeps_all_of_the_front(drawn):
    found = swept(drawn)
    kept = survivors(found)
    assert kept[0].name == EXACT
    assert {each.candidate.name for each in found if each.front} <= {each.name for each in kept}


@given(savings)
def test_the_ladder_descends_on_the_front_and_names_what_fits(drawn):
    found = swept(drawn)
    rungs = name_rungs(found)
    assert rungs[0].rung == EXACT
    assert all(each.front for each in rungs)
    assert len({each.rung for each in rungs}) == len(rungs)
    fidelity = [each.fidelity for each in rungs]
    assert fidelity == sorted(fidelity, reverse=True)
    by_name = {each.rung: each for each in rungs}
    for name, share in (("balanced", BALANCED_SHARE), ("draft", DRAFT_SHARE)):
        fits = [p for p in found if p.cost <= share and p.candidate.options]
        if fits:
            assert by_name[name].cost <= share
            assert by_name[name].fidelity == max(p.fidelity for p in fits)
        else:
            assert by_name[name].cost == min(p.cost for p in found)


def test_the_runtime_reads_the_ladder(tmp_path):
    found = swept([(0.5, 400), (0.2, 300), (0.07, 200)])
    rungs, path = name_rungs(found), tmp_path / "ladder.json"
    path.write_text(json.dumps(ladder_record(found, {"scenes": 3})))
    read = read_ladder(path=path)
    assert [(rung.name, rung.options) for rung in read] == [
        (each.rung, each.candidate.options) for each in rungs
    ]
    assert [rung.name for rung in read] == [EXACT, "s0.5", "balanced", "draft"]
    assert [rung.fidelity_db for rung in read] == [None, 40.0, 30.0, 20.0]


def test_models_without_reuse_have_a_ladder_of_their_own(tmp_path):
    shared = point(0.1, 40.0, "shared")
    shared = replace(shared, candidate=replace(shared.candidate, options={"reuse": 3}))
    found = front([point(1.0, 100.0, EXACT), shared, point(0.2, 30.0, "steps")])
    path = tmp_path / "ladder.json"
    path.write_text(json.dumps(ladder_record(found, {})))
    assert [rung.options for rung in read_ladder(path=path)][-1] == {"reuse": 3}
    for rung in read_ladder(reusable=False, path=path):
        assert "reuse" not in rung.options


def test_a_busy_clock_does_not_lose_the_ladder():
    slower = [point(1.2, 40.0, "slower"), point(1.1, 30.0, "slow"), point(1.3, 20.0, "worst")]
    rungs = name_rungs(front([point(1.0, 100.0, EXACT), *slower]))
    assert rungs[0].candidate.name == EXACT
    assert {each.candidate.name for each in rungs[1:]} == {"slow"}
    with pytest.raises(ResultsError, match="expected savings"):
        name_rungs(front([point(1.0, 100.0, EXACT)]))


def test_named_plans_lose_no_more_than_they_may_where_one_does():
    found = front(
        [
            point(1.0, 100.0, EXACT),
            point(0.24, 32.0, "faithful", loss=0.2),
            point(0.20, 30.0, "keeps", loss=0.05),
            point(0.08, 20.0, "lossy", loss=0.7),
            point(0.07, 19.0, "light", loss=0.5),
        ]
    )
    by_rung = {each.rung: each.candidate.name for each in name_rungs(found)}
    assert by_rung["balanced"] == "keeps"
    assert by_rung["draft"] == "light"


def test_claims_say_what_does_not_hold():
    lossy = point(0.2, 30.0, "lossy", loss=0.3)
    fast = point(0.05, 20.0, "fast", loss=0.4)
    rungs = name_rungs(front([point(1.0, 100.0, EXACT), lossy, fast]))
    found = {text.partition(" (")[0]: holds for text, holds in claims(rungs)}
    assert found == {
        "balanced: time ≤ 1/4 of exact": True,
        "balanced: object PSNR lost ≤ 0.1 dB": False,
        "balanced: light following lost ≤ 2 points": False,
        "draft: time ≤ 1/12 of exact": True,
        "draft: object PSNR lost ≤ 0.5 dB": True,
    }


def test_shares_of_time_are_of_the_same_round():
    made = [
        Result("room", "gt_dir", name, "", {"truth": {}, "exact": {}}, seconds=predicted)
        for name, predicted in ((EXACT, 4.0), ("half", 1.0))
    ]
    # The machine is ten times as slow in one round, which touches neither share.
    timings = [
        Timing(number, "room", name, slow * seconds)
        for number, slow in enumerate((1.0, 10.0, 1.0))
        for name, seconds in ((EXACT, 2.0), ("half", 1.0))
    ]
    exact, half = points(made, [Candidate(EXACT), Candidate("half", {"steps": 2})], timings)
    assert (exact.share, half.share, half.seconds) == (1.0, 0.5, 1.0)
    assert half.predicted_share == 0.25
    assert half.cost == 0.5


@pytest.fixture(scope="module")
def slow_folder(tmp_path_factory):
    """A tiny backbone whose evaluations take most of the time, so that leaving some out shows."""
    folder = tmp_path_factory.mktemp("models") / "tiny"
    return write_backbone(folder, tiny_spec(steps=2), hidden=4096)


@pytest.fixture(scope="module")
def run(slow_folder, testset, tmp_path_factory):
    """Sweep as the command line does, with costs kept in a folder of its own."""
    app = typer.Typer()
    app.command()(pareto)
    cache = {"XDG_CACHE_HOME": str(tmp_path_factory.mktemp("cache"))}

    def call(output, *arguments, data=testset):
        given = [str(data), "--model", str(slow_folder), "-o", str(output), "--threads", "1"]
        given += [str(argument) for argument in arguments]
        return CliRunner(env=cache).invoke(app, given)

    return call


@pytest.fixture(scope="module")
def finished(run, tmp_path_factory):
    output = tmp_path_factory.mktemp("pareto") / "out"
    side = output.parent
    outcome = run(output, "--quick", "--json", side / "all.json", "--ladder", side / "ladder.json")
    assert outcome.exception is None, outcome.output
    return output


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_run_writes_curve_table_and_ladder(finished):
    names = {path.name for path in finished.iterdir()}
    assert names == {
        *("pareto.csv", "pareto.md", "pareto.svg", "pareto.png", "ladder.json", "results.jsonl")
    }
    with Image.open(finished / "pareto.png") as picture:
        assert picture.width > 1000
        assert len(set(picture.convert("L").tobytes())) > 10  # something is drawn
    ladders = [read_ladder(path=f / "ladder.json") for f in (finished.parent, finished)]
    assert ladders[0] == ladders[1]
    found = rows(finished / "pareto.csv")
    everything = json.loads((finished.parent / "all.json").read_text())
    names = [each.name for each in candidates(QUICK, 2, ("tiny",))]
    assert [row["candidate"] for row in found] == names
    assert len(everything["points"]) == len(names)
    assert len(everything["timings"]) == len(names) * 2
    exact = found[0]
    assert (exact["candidate"], exact["rung"], exact["evaluations"]) == (EXACT, EXACT, "6")
    assert float(exact["exact_object_psnr"]) == 100.0
    assert float(exact["share"]) == 1.0
    for row in found[1:]:
        assert float(row["exact_object_psnr"]) < 100.0 or "-g" not in row["candidate"]
        assert float(row["seconds"]) > 0.0
        assert int(row["peak_memory_bytes"]) > 10_000_000
        assert float(row["object_psnr_low"]) <= float(row["object_psnr"])


def test_a_stopped_run_goes_on_and_a_finished_one_makes_nothing(run, finished, tmp_path):
    output = tmp_path / "out"
    output.mkdir()
    shutil.copy(finished / "results.jsonl", output)
    refused = run(output, "--quick")
    assert "--resume" in str(refused.exception)
    lines = (finished / "results.jsonl").read_text().splitlines(keepends=True)
    (output / "results.jsonl").write_text("".join(lines[:9]) + lines[9][:20])
    outcome = run(output, "--quick", "--resume", "--rounds", 3)
    assert outcome.exception is None, outcome.output

    def scores(path):
        made = [json.loads(line) for line in path.read_text().splitlines()[1:]]
        return {
            (r["scene"], r["direction"], r["method"], kind): found
            for r in made
            for kind, found in r["scores"].items()
        }

    again, once = scores(output / "results.jsonl"), scores(finished / "results.jsonl")
    assert set(again) == set(once)
    for key, found in again.items():  # ST-LPIPS of another batch differs in the last bits
        assert found == pytest.approx(once[key], rel=1e-4)


def test_results_of_another_set_are_not_gone_on_with(run, finished, testset, tmp_path):
    output = tmp_path / "out"
    output.mkdir()
    shutil.copy(finished / "results.jsonl", output)
    other = shutil.copytree(testset, tmp_path / testset.name)
    (other / "room_0" / "shadow_positive_0000.png").write_bytes(b"another")
    refused = run(output, "--quick", "--resume", data=other)
    assert "of another run: data_fingerprint" in str(refused.exception)
    first, *_ = (output / "results.jsonl").read_text().splitlines()
    assert json.loads(first)["settings"]["version"] == version("spotlight-relight")
