"""The stability command, its tables and its plot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.onnx_backbone import write_backbone

from spotlight_bench.stability import (
    NUDGE,
    Measured,
    measure_all,
    nudged,
    relative_change,
    trajectory,
)
from spotlight_bench.stability_cases import LOOP_CASES, MASKS, LoopCase, mask_named
from spotlight_bench.stability_command import stability
from spotlight_bench.stability_models import measure_model
from spotlight_bench.stability_network import SmallDenoiser
from spotlight_bench.stability_report import loop_table, plot, write_section

SHORT = LoopCase("short", "two steps", steps=2, size=(3, 4))


@pytest.fixture(scope="module")
def measured() -> list[Measured]:
    return list(measure_all([SHORT, *LOOP_CASES[:1]]))


def test_less_precision_errs_more(measured: list[Measured]) -> None:
    errors = {each.precision: each.errors[-1] for each in measured if each.case == "short"}
    assert 1e-9 < errors["fp32"] < 1e-2 * errors["fp16"] < 1e-3 * errors["int8"] < 1e-3


def test_table_has_a_row_a_case(measured: list[Measured]) -> None:
    rows = [line for line in loop_table(measured).splitlines() if line.startswith("| ")]
    assert [row.split(" | ")[0] for row in rows[1:]] == ["| short", "| ddim, 1 steps"]
    assert f"{len(measured)} of {len(measured)} runs" in loop_table(measured)


def test_run_that_is_refused_is_said_to_be() -> None:
    case = LoopCase("hopeless", "overflows", steps=2, scale=3e38, composite_scale=3e38)
    refused = Measured(case.name, "fp16", "step 0 (timestep 999): ...", (), (), 0.0)
    usual = Measured(case.name, "fp32", "", (1e-7, 2e-7), (1.0, 1.0), 1e-7)
    table = loop_table([usual, refused, Measured(case.name, "int8", "", (0.1,), (1.0,), 0.1)])
    assert "| refused | – |" in table
    assert "Finite: 2 of 3 runs" in table


def test_plot_is_a_picture(measured: list[Measured], tmp_path: Path) -> None:
    plot(measured, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_sections_are_replaced_and_the_rest_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "report.md"
    write_section(path, "one", "old")
    write_section(path, "two", r"\1 is no group")
    path.write_text(path.read_text().replace("<!-- two -->", "Prose.\n\n<!-- two -->"))
    write_section(path, "one", "new")
    assert path.read_text() == (
        "# Stability\n\n<!-- one -->\nnew\n<!-- /one -->\n\nProse.\n\n"
        "<!-- two -->\n\\1 is no group\n<!-- /two -->\n"
    )


def test_nudge_is_as_large_as_it_says() -> None:
    inputs = SHORT.inputs(np.float64)
    moved = nudged(inputs)
    assert relative_change(moved.initial_noise, inputs.initial_noise) == pytest.approx(NUDGE)
    assert moved.step_noise is inputs.step_noise


def test_change_of_denormals_is_no_zero_over_zero() -> None:
    tiny = np.float64([3e-320, 4e-320])
    assert relative_change(2.0 * tiny, tiny) == pytest.approx(1.0)
    assert relative_change(np.zeros(2), np.zeros(2)) == 0.0


@pytest.mark.parametrize("name", MASKS)
@pytest.mark.parametrize("size", [(8, 8), (64, 96), (16, 128)])
def test_masks_are_what_their_names_say(name: str, size: tuple[int, int]) -> None:
    mask = mask_named(name, size)
    assert mask.dtype == np.float32
    assert mask.shape == size
    assert 0.0 <= mask.min() <= mask.max() <= 1.0
    assert (mask.max() > 0.0) == (name != "empty")


def test_the_network_answers_each_branch_alone() -> None:
    """Predictions of one branch are the same whether the other is asked or not."""
    inputs = SHORT.inputs(np.float64)
    network = SmallDenoiser(SHORT.condition())
    both = np.repeat(inputs.initial_noise, 2, axis=0)
    np.testing.assert_allclose(network(both, 500)[:1], network(both[:1], 500), rtol=1e-12)
    assert len(trajectory(SHORT, inputs, network)) == SHORT.steps


def test_models_are_measured_by_folder(tmp_path: Path) -> None:
    folder = write_backbone(tmp_path / "tiny")
    (usual,) = measure_model(str(folder), gammas=(3.0,), threads=1)
    assert usual.model == "tiny"
    assert len(usual.sensitivities) == len(usual.rounded) == 4
    assert 0.0 < usual.rounded[0] < 1e-5
    (broken,) = measure_model(
        str(write_backbone(tmp_path / "broken", gain=np.inf)), gammas=(3.0,), threads=1
    )
    assert broken.refused.startswith("step 0 (timestep 999): the denoiser's prediction")


@pytest.mark.full
def test_the_command_writes_tables_plot_and_figures(tmp_path: Path) -> None:
    model = str(write_backbone(tmp_path / "tiny"))
    stability(tmp_path / "out", [model], quick=True, json_file=tmp_path / "all.json", threads=1)
    report = (tmp_path / "out" / "stability.md").read_text()
    assert "<!-- loop -->" in report
    assert "| tiny | fp32 | 3 | yes |" in report
    assert (tmp_path / "out" / "stability.png").is_file()
    assert '"case": "ddim, 50 steps"' in (tmp_path / "all.json").read_text()
