"""Whole evaluations with a tiny random backbone on two tiny scenes."""

import csv
import json
import shutil

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from bench.published import AZIMUTHS, write_set
from spotlight_bench import cli
from spotlight_bench.evaluate_command import evaluate
from spotlight_runtime import read_image
from spotlight_runtime.imaging.colour import linear_to_srgb

METHODS = "pasted,no-control,sdedit,spotlight,gamma-1"
OUTPUTS = {"tables.md", "images.csv", "methods.csv", "results.jsonl", "sheet.png"}


@pytest.fixture(scope="module")
def run(backbone_folder):
    """Evaluate as the command line does, and return the command's outcome."""
    import typer

    app = typer.Typer()
    app.command()(evaluate)

    def call(data, output, *arguments):
        return CliRunner().invoke(
            app,
            ["--data", str(data), "--model", str(backbone_folder), "-o", str(output)]
            + ["--threads", "1"]
            + [str(argument) for argument in arguments],
        )

    return call


@pytest.fixture(scope="module")
def finished(run, testset, tmp_path_factory):
    """Folder of a whole run: two scenes, one of them under eight azimuths too."""
    output = tmp_path_factory.mktemp("run") / "out"
    arguments = ("--methods", METHODS, "--user-scenes", 1, "--json", output.parent / "all.json")
    outcome = run(testset, output, *arguments)
    assert outcome.exception is None, outcome.output
    (output.parent / "stdout.txt").write_text(outcome.output)
    return output


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_output_is_there(finished):
    assert {p.name for p in finished.iterdir()} == OUTPUTS | {"directions.webp", "images"}
    told = (finished.parent / "stdout.txt").read_text()
    for expected in ("Reference-based, full image (2 pictures", "light following (8 pictures", "±"):
        assert expected in told


def test_tables_have_the_papers_columns_and_a_row_a_method(finished):
    text = (finished / "tables.md").read_text()
    assert "| method | PSNR↑ | SSIM↑ | RMSE↓ | MAE↓ | ST-LPIPS↓ | ꟻLIP↓ |" in text
    assert "| method | top-1↑ | within ±45°↑ |" in text
    titles = [line for line in text.splitlines() if line.startswith("## ")]
    assert len(titles) == 3 + 4 + 2
    for label in ("pasted object", "no control (ZeroComp)", "ZeroComp+SDEdit", "SpotLight γ=3"):
        assert text.count(f"| {label}") == 3 + 4 + 1
    assert "| light following: top-1 ≥ 80% |" in text


def test_figures_in_csv_json_and_results_agree(finished):
    found = json.loads((finished.parent / "all.json").read_text())
    assert found["pictures"] == {"reference-based": 2, "user-controlled": 8}
    pictures = rows(finished / "images.csv")
    assert len(pictures) == 5 * (2 + 8)
    ours = [
        float(row["foreground_psnr"])
        for row in pictures
        if row["method"] == "spotlight" and row["direction"] == "gt_dir"
    ]
    wanted = ("spotlight", "reference-based", "foreground", "psnr")
    (figure,) = (
        f for f in found["figures"] if (f["method"], f["task"], f["region"], f["metric"]) == wanted
    )
    assert figure["mean"] == pytest.approx(np.mean(ours), abs=1e-4)
    assert figure["scenes"] == 2
    assert figure["low"] == pytest.approx(min(ours), abs=1e-4)
    assert figure["high"] == pytest.approx(max(ours), abs=1e-4)
    assert len(rows(finished / "methods.csv")) == len(found["figures"])
    every = [float(row["full_st_lpips"]) for row in pictures]
    assert all(0.0 < value < 2.0 for value in every)
    assert found["worst_background_change"]["spotlight"] <= 1 / 255
    assert found["evaluations"] == {
        "pasted": 0,
        "no-control": 0,
        "sdedit": 3,
        "spotlight": 4,
        "gamma-1": 2,  # guided by nothing: no negative branch
    }


def test_a_method_blind_to_the_light_is_right_by_chance_alone(finished):
    found = json.loads((finished.parent / "all.json").read_text())
    following = {
        (f["method"], f["metric"]): f["mean"]
        for f in found["figures"]
        if f["metric"] in ("top_1", "within_45")
    }
    for method in ("pasted", "no-control"):
        assert following[method, "top_1"] == 0.125
        assert following[method, "within_45"] == 0.375
    assert ("spotlight", "top_1") in following


def test_sheet_and_animation_show_what_was_made(finished, testset):
    sheet = np.asarray(Image.open(finished / "sheet.png"))
    # Two rows for the scene with azimuths, one for the other; shadow, three baselines, ours, truth.
    assert sheet.shape == (3 * (64 + 22 + 4) - 4, 6 * 68 - 4, 3)
    ours = read_image(finished / "images" / "spotlight" / "room_0" / "gt_dir.png")
    np.testing.assert_array_equal(sheet[22:86, 4 * 68 : 4 * 68 + 64], np.round(255 * ours))
    truth = linear_to_srgb(read_image(testset / "room_0" / "truth_0001.exr"))
    np.testing.assert_allclose(sheet[22:86, 5 * 68 : 5 * 68 + 64] / 255.0, truth, atol=0.004)
    with Image.open(finished / "directions.webp") as animation:
        assert animation.n_frames == 8
        assert animation.size == (3 * 68 - 4, 64 + 22)


def test_resuming_a_finished_run_makes_nothing_and_says_the_same(run, finished, testset, tmp_path):
    output = shutil.copytree(finished, tmp_path / "out")
    shutil.rmtree(output / "images" / "sdedit")
    refused = run(testset, output, "--methods", METHODS, "--user-scenes", 1)
    assert "--resume" in str(refused.exception)
    outcome = run(testset, output, "--methods", METHODS, "--user-scenes", 1, "--resume")
    assert outcome.exception is None
    assert not (output / "images" / "sdedit").exists()
    for name in ("results.jsonl", "methods.csv", "tables.md"):
        assert (output / name).read_bytes() == (finished / name).read_bytes()


def test_a_stopped_run_goes_on_to_the_same_figures(run, finished, testset, tmp_path):
    output = tmp_path / "out"
    output.mkdir()
    lines = (finished / "results.jsonl").read_text().splitlines(keepends=True)
    (output / "results.jsonl").write_text("".join(lines[:41]) + lines[41][:30])
    outcome = run(testset, output, "--methods", METHODS, "--user-scenes", 1, "--resume")
    assert outcome.exception is None
    again = (output / "results.jsonl").read_text().splitlines()
    assert len(again) == len(lines)
    assert (output / "methods.csv").read_bytes() == (finished / "methods.csv").read_bytes()


def test_results_of_another_set_or_version_are_not_gone_on_with(run, finished, testset, tmp_path):
    output = tmp_path / "out"
    output.mkdir()
    text = (finished / "results.jsonl").read_text()
    (output / "results.jsonl").write_text(text)
    other = shutil.copytree(testset, tmp_path / testset.name)
    shadows = [other / "room_0" / f"shadow_positive_{name}.png" for name in AZIMUTHS]
    shutil.copy(*shadows[:2])
    arguments = ("--methods", METHODS, "--user-scenes", 1, "--resume")
    refused = run(other, output, *arguments)
    assert "of another run: data_fingerprint" in str(refused.exception)
    (output / "results.jsonl").write_text(text.replace('"version": "', '"version": "0.0.', 1))
    refused = run(testset, output, *arguments)
    assert "of another run: version" in str(refused.exception)


def test_a_folder_of_pictures_is_scored_as_the_method_that_made_them(
    run, finished, testset, tmp_path
):
    """Pictures are scored as they are written, so ours, read back, get our own figures."""
    folder = finished / "images" / "spotlight"
    outcome = run(
        testset, tmp_path / "out", "--methods", "", "--method", f"again={folder}", "--scenes", 2,
        "--user-scenes", 1,
    )  # fmt: skip
    assert outcome.exception is None, outcome.output
    wanted = {
        (row["scene"], row["direction"]): row
        for row in rows(finished / "images.csv")
        if row["method"] == "spotlight"
    }
    found = rows(tmp_path / "out" / "images.csv")
    assert len(found) == 10
    for row in found:
        other = wanted[row["scene"], row["direction"]]
        for name in row:
            if name.endswith(("psnr", "ssim", "flip")) or name.startswith("distance"):
                assert row[name] == other[name]


def test_missing_pictures_of_another_method_stop_the_run_before_it_begins(run, testset, tmp_path):
    folder = tmp_path / "other"
    (folder / "room_0").mkdir(parents=True)
    shutil.copy(testset / "room_0" / "room_0_bg_diffuse.png", folder / "room_0" / "gt_dir.png")
    arguments = ("--methods", "pasted", "--method", f"other={folder}", "--user-scenes", 0)
    outcome = run(testset, tmp_path / "out", *arguments)
    assert "room_1/gt_dir.png, found 1 of 2 reference-based" in str(outcome.exception)
    assert not (tmp_path / "out").exists()
    shutil.copytree(folder / "room_0", folder / "room_1")
    outcome = run(testset, tmp_path / "out", *arguments[:-1], 1)
    assert outcome.exception is None  # it lacks all of the user-controlled ones, and is left out
    found = rows(tmp_path / "out" / "images.csv")
    assert sum(row["method"] == "other" for row in found) == 2
    (folder / "room_0" / "gt_dir.png").unlink()
    (folder / "room_1" / "gt_dir.png").unlink()
    outcome = run(testset, tmp_path / "none", *arguments)
    assert "found 0 of 2" in str(outcome.exception)


def test_a_set_without_truths_gives_pictures_and_no_figures(run, tmp_path):
    data = write_set(tmp_path / "real", 1, truths=False)
    outcome = run(
        data, tmp_path / "out", "--methods", "pasted,spotlight", "--scenes", 0, "--user-scenes", 1
    )
    assert outcome.exception is None, outcome.output
    assert "no figures" in outcome.output
    made = {p.relative_to(tmp_path / "out" / "images") for p in (tmp_path / "out").rglob("0*.png")}
    assert {str(p) for p in made} == {
        f"{method}/room_0/{k}.png" for method in ("pasted", "spotlight") for k in AZIMUTHS
    }
    with Image.open(tmp_path / "out" / "directions.webp") as animation:
        assert animation.size == (2 * 68 - 4, 64 + 22)


def test_errors_are_one_line(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("sys.argv", ["spotlight-bench", "evaluate", "--data", str(tmp_path)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 1
    told = capsys.readouterr().err
    assert told.startswith("spotlight-bench: ")
    assert "export-testset" in told
    assert told.count("\n") == 1
