"""Named plans, and budgets in seconds that choose one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow
from typer.testing import CliRunner

from spotlight_runtime import GuidingShadow, Relighter, RelightOptions
from spotlight_runtime.cli import app
from spotlight_runtime.errors import BudgetError, InvalidInputError
from spotlight_runtime.planning.costs import (
    Costs,
    Line,
    Pace,
    Seconds,
    cache_path,
    read_costs,
    write_costs,
)
from spotlight_runtime.planning.ladder import LADDER_FILE, named_rung, read_ladder

SLOW = Costs(
    evaluation=Line(1.0, 0.0),
    condition=Line(0.1, 0.0),
    encode=Line(0.1, 0.0),
    decode=Line(0.1, 0.0),
    frame=Line(0.1, 0.0),
    window=Line(0.1, 0.0),
)
"""A machine on which an evaluation takes a second."""


@pytest.fixture
def slow(relighter):
    made = Relighter(relighter.spec, relighter._networks, remember=0)
    made.costs = SLOW
    return made


@pytest.mark.parametrize("reusable", [True, False])
def test_ladder_descends_and_has_the_named_plans(reusable):
    rungs = read_ladder(reusable)
    assert reusable or not any("reuse" in rung.options for rung in rungs)
    assert rungs[0].name == "exact"
    assert rungs[0].options == {}
    fidelity = [rung.fidelity_db for rung in rungs if rung.fidelity_db is not None]
    assert fidelity == sorted(fidelity, reverse=True)


def test_a_named_plan_is_where_options_start(relighter, scene, shadow):
    draft = named_rung("draft", reusable=False).options
    made = relighter.relight(scene, shadow, plan="draft", denoise=False)
    same = relighter.relight(scene, shadow, denoise=False, **draft)
    np.testing.assert_array_equal(made.image, same.image)
    assert made.plan.name == "draft"
    assert made.options.solver == draft["solver"]
    changed = relighter.prepare(scene, shadow, plan="draft", steps=3, denoise=False)
    assert changed.options.steps == 3
    based = RelightOptions(seed=5, denoise=False)
    assert relighter.prepare(scene, shadow, None, based, plan="draft").options.seed == 5


def test_a_budget_takes_the_most_accurate_plan_that_fits(slow, scene, shadow):
    seconds = {
        rung.name: slow.prepare(scene, shadow, denoise=False, **rung.options).plan.seconds
        for rung in read_ladder(reusable=False)
    }
    for rung in read_ladder(reusable=False):
        enough = seconds[rung.name] + 0.5
        plan = slow.prepare(scene, shadow, budget=enough, denoise=False).plan
        assert plan.seconds <= enough
        fits = [
            other.name for other in read_ladder(reusable=False) if seconds[other.name] <= enough
        ]
        assert plan.name == fits[0]


def test_a_budget_too_small_names_what_is_needed(slow, scene, shadow):
    quickest = slow.prepare(scene, shadow, plan="draft", denoise=False).plan.seconds
    with pytest.raises(BudgetError, match=f"expected at least {quickest:.2g} s"):
        slow.prepare(scene, shadow, budget=0.5, denoise=False)


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ({"plan": "fast"}, "plan: expected exact, balanced, draft, got 'fast'"),
        ({"budget": 0.0}, "budget: expected seconds above 0, got 0.0"),
        ({"budget": float("nan")}, "budget: expected seconds above 0, got nan"),
        ({"plan": "draft", "budget": 1.0}, "plan, budget: expected one of them"),
    ],
)
def test_impossible_wishes_are_errors(relighter, scene, shadow, wishes, message):
    with pytest.raises(InvalidInputError, match=message):
        relighter.prepare(scene, shadow, **wishes)


def test_predicted_seconds_are_those_of_the_calls(slow, scene, shadow):
    plan = slow.prepare(scene, shadow, denoise=False).plan
    prepared = {e.name: e.seconds for e in plan.effects}["soft shadows"]
    calls = plan.calls()
    others = calls["condition_encoder"] + calls["vae_encoder"] + calls["vae_decoder"] + 1
    assert plan.seconds == pytest.approx(prepared + calls["denoiser"] + 0.1 * others)


def test_every_pass_that_is_run_starts_cold(slow, scene, shadow):
    usual = slow.prepare(scene, shadow, denoise=False).plan
    slow.costs = replace(SLOW, start=Line(2.0, 0.0))
    for lights in ([shadow], [shadow, 0.5 * shadow]):
        plan = slow.prepare(scene, lights, denoise=False).plan
        seconds = {e.name: e.seconds for e in plan.effects}
        assert seconds["pass without shadow"] == pytest.approx(
            {e.name: e.seconds for e in usual.effects}["pass without shadow"] + 2.0
        )
        assert plan.passes_run == len(lights) + 1
        assert seconds["relight"] >= len(lights) * (2.0 + plan.passes[0].steps)


@pytest.mark.parametrize("factor", [0.4, 0.9, 3.0])
def test_pace_follows_the_machine(factor):
    pace = Pace()
    for _ in range(40):
        now = pace.of(SLOW)
        pace.learn(Seconds(now.evaluation.at(0), now.decode.at(0)), Seconds(factor, 0.2 * factor))
    now = pace.of(SLOW)
    assert now.evaluation.fixed == pytest.approx(factor, rel=0.01)
    assert now.decode.fixed == pytest.approx(2.0 * factor * SLOW.decode.fixed, rel=0.01)
    assert Line(0.5, 2.0, 1.0).slowed(3.0) == Line(1.5, 6.0, 3.0)


def test_evaluations_and_the_rest_have_paces_of_their_own():
    pace = Pace()
    pace.learn(Seconds(1.0, 0.0), Seconds(1.5, 0.0))  # nothing of the rest: nothing learnt of it
    now = pace.of(SLOW)
    assert now.evaluation.fixed > SLOW.evaluation.fixed
    assert now.condition == SLOW.condition
    pace.learn(Seconds(0.0, 1.0), Seconds(0.0, 0.5))
    assert pace.of(SLOW).evaluation == now.evaluation
    assert pace.of(SLOW).window.fixed < SLOW.window.fixed


def test_one_relight_out_of_line_is_no_new_pace():
    pace = Pace()
    pace.learn(Seconds(1.0, 1.0), Seconds(1000.0, 1000.0))
    assert 1.0 < pace.of(SLOW).evaluation.fixed < 1.2
    assert SLOW.decode.fixed < pace.of(SLOW).decode.fixed < 1.2 * SLOW.decode.fixed


def test_predictions_follow_the_relights(slow, scene, shadow):
    """The machine turns out to be far quicker than its costs say, and each relight shows it."""
    promised, took = [], []
    for _ in range(20):
        made = slow.relight(scene, shadow, steps=2, denoise=False)
        promised.append(made.plan.seconds)
        took.append(sum(made.timings.values()))
    usual = sorted(took)[10]  # the first of a process takes many times as long
    assert promised[0] > 10.0 * usual
    assert promised[-1] < 0.25 * promised[0]
    assert slow.costs == SLOW
    slow.calibrated(again=True)
    assert slow._costs_for(True) == slow.costs


def test_machine_is_measured_once_and_remembered(backbone, monkeypatch, tmp_path, scene, shadow):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = Relighter.load(backbone, threads=1)
    assert first.costs is None
    assert first.prepare(scene, shadow, denoise=False).plan.seconds is None
    assert first.plan(scene, shadow, denoise=False).seconds > 0.0
    (file,) = tmp_path.rglob("*.json")
    assert read_costs(file) == first.costs == Relighter.load(backbone, threads=1).costs
    assert Relighter.load(backbone, threads=2).costs is None
    file.write_text("{")
    assert Relighter.load(backbone, threads=1).costs is None


@pytest.mark.parametrize("hours", [2.0, -3.0], ids=["hours ago", "before a restart"])
def test_old_costs_are_measured_again_once(backbone, monkeypatch, tmp_path, hours):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = Relighter.load(backbone, threads=1)
    first.calibrated()
    (file,) = tmp_path.rglob("*.json")
    write_costs(file, SLOW)
    assert Relighter.load(backbone, threads=1).calibrated() == SLOW
    record = json.loads(file.read_text())
    file.write_text(json.dumps(record | {"measured": record["measured"] - 3600.0 * hours}))
    late = Relighter.load(backbone, threads=1)
    assert late.costs == SLOW  # better than none, for whoever does not ask to be told exactly
    measured = late.calibrated()
    assert measured != SLOW
    assert late.calibrated() is measured
    assert read_costs(file) == measured


def test_costs_that_are_none_are_measured_again(tmp_path):
    path = tmp_path / "costs.json"
    write_costs(path, SLOW)
    record = json.loads(path.read_text())
    for name, value in (("version", 0), ("costs", {}), ("costs", {"evaluation": 1})):
        path.write_text(json.dumps(record | {name: value}))
        assert read_costs(path) is None
    record["costs"]["encode"]["each"] = -1.0
    path.write_text(json.dumps(record))
    assert read_costs(path) is None
    write_costs(tmp_path / "costs.json/below", SLOW)  # no folder can be there: not an error


def test_lines_rise_and_have_a_least():
    assert Line.through([1.0, 2.0], [3.0, 5.0]).at(3.0) == pytest.approx(7.0)
    bent = Line.through([1.0, 2.0], [1.0, 3.0])  # what is small costs less than its share
    assert [bent.at(size) for size in (0.0, 1.0, 2.0)] == pytest.approx([1.0, 1.0, 3.0])
    assert Line.through([1.0, 2.0], [3.0, 1.0]) == Line(2.0, 0.0)
    assert Line.through([2.0, 2.0], [3.0, 4.0]).at(4.0) == pytest.approx(8.0)


def test_cache_is_one_a_model_and_machine(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    paths = {cache_path(model, threads) for model in ("a", "b") for threads in (None, 1)}
    assert len(paths) == 4
    assert all(tmp_path in path.parents for path in paths)


def test_costs_are_those_of_the_provider_that_runs(backbone, monkeypatch, tmp_path):
    """What a CPU takes must not choose a GPU's plan."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: ["First", "Second"])
    write_costs(Relighter.load(backbone, providers=["First"])._costs_file, SLOW)
    assert Relighter.load(backbone, providers=["First"]).costs == SLOW
    assert Relighter.load(backbone, providers=["Second"]).costs is None


@pytest.mark.parametrize("batched", [False, True])
def test_each_picture_of_several_has_its_part_of_the_plan(slow, scene, shadow, negative, batched):
    lights = [
        GuidingShadow(shadow, negative),
        GuidingShadow(negative, shadow),
        GuidingShadow(shadow, shadow),  # nothing to contrast
    ]
    task = slow.prepare(scene, lights, denoise=False, batch_branches=batched)
    assert sum(part.seconds for part in task.parts) == pytest.approx(task.plan.seconds)
    for number, part in enumerate(task.parts):
        effects = {effect.name: effect for effect in part.effects}
        assert sum(effect.evaluations for effect in part.effects) == part.evaluations
        assert effects["pass without shadow"].on == (number == 0)
        assert effects["guidance"].on == (number < 2)
        assert not effects["relight"].reason.startswith("3 lights")
    made = [*slow.relight_each(scene, lights, denoise=False, batch_branches=batched)]
    assert [each.plan.effects[0] for each in made] == [part.effects[0] for part in task.parts]


def test_ladder_file_ships():
    assert LADDER_FILE.is_file()


@pytest.fixture
def house(tmp_path, backbone, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    scene = make_scene(64, 96)
    replace(scene, name="chair").save(tmp_path / "chair")
    from spotlight_runtime import write_image

    write_image(tmp_path / "left.png", make_shadow(scene, "left"))
    monkeypatch.chdir(tmp_path)
    return backbone


def test_plan_command_prints_a_table_and_json(house):
    arguments = ["plan", "chair", "--shadow", "left.png", "--model", str(house), "--gamma", "1"]
    table = CliRunner().invoke(app, arguments)
    assert table.exit_code == 0, table.output
    for expected in ("exact plan", "guidance", "γ = 1 adds nothing", "in all"):
        assert expected in table.output
    record = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).output)
    assert record["evaluations"] == 8
    assert record["calls"] == {
        "denoiser": 8, "vae_encoder": 1, "condition_encoder": 2, "vae_decoder": 2,
    }  # fmt: skip
    assert record["predicted_seconds"] > 0.0
    assert {e["name"] for e in record["effects"]} >= {"relight", "guidance", "window"}


def test_relight_command_keeps_to_a_budget(house):
    common = [
        "chair",
        "--shadow",
        "left.png",
        "--model",
        str(house),
        "--no-denoise",
        "-o",
        "out.png",
    ]
    done = CliRunner().invoke(app, ["relight", *common, "--budget", "60", "--report", "r.json"])
    assert done.exit_code == 0, done.output
    with open("r.json") as stream:
        record = json.load(stream)
    assert record["plan"]["name"] == "exact"
    assert record["plan"]["predicted_seconds"] <= 60.0
    assert "exact plan, 12 evaluations" in done.output
    draft = CliRunner().invoke(app, ["relight", *common, "--plan", "draft"])
    assert "draft plan" in draft.output
    assert isinstance(
        CliRunner().invoke(app, ["relight", *common, "--budget", "-1"]).exception, InvalidInputError
    )
