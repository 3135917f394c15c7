"""The command teaches, and fails in one line."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from spotlight_export import __main__, cases, tolerances, verify
from spotlight_export.cli import app
from spotlight_spec import Manifest

runner = CliRunner()


def test_help_shows_the_first_command_to_type():
    result = runner.invoke(app, ["--help"])
    assert result.exit_code == 0
    assert "spotlight-export zerocomp --base" in result.output
    for command in ("verify", "quantise"):
        assert command in result.output


def test_help_offers_backbones_that_can_be_exported():
    told = runner.invoke(app, ["export", "--help"]).output
    assert "zerocomp-interiorverse" in "".join(told.split())  # wrapped at hyphens
    assert not re.search(r"\bmini\b", told)


@pytest.mark.parametrize("words", [["zerocomp-openrooms"], ["zerocomp"], ["export"], ["verify"]])
def test_help_of_every_form(words):
    result = runner.invoke(app, [*words, "--help"])
    assert result.exit_code == 0
    assert "Usage" in result.output


def test_quantise_then_verify(fused, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "QUICK_SHAPES", (((8, 12), 1),))
    monkeypatch.setattr(verify, "LOOP_SIZES", {False: ((9, 8),)})
    out = tmp_path / "half"
    result = runner.invoke(app, ["quantise", str(fused), "-o", str(out), "--precision", "fp16"])
    assert result.exit_code == 0, result.output
    assert "fp16" in result.output
    result = runner.invoke(app, ["verify", str(out), "--quick"])
    assert result.exit_code == 0, result.output
    assert "denoiser" in result.output
    assert Manifest.read(out).parity

    monkeypatch.setitem(tolerances.GRAPH_TOLERANCE, "fp16", 1e-9)
    result = runner.invoke(app, ["verify", str(out), "--quick"])
    assert result.exit_code == 1
    assert "past tolerance" in result.output


def test_an_error_is_one_line(checkpoint, tmp_path):
    result = subprocess.run(
        [
            *(sys.executable, "-m", "spotlight_export", "zerocomp-openrooms-wo-depth"),
            *("--base", checkpoint.base, "--controlnet", checkpoint.controlnet),
            *("-o", tmp_path / "out"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert "has 10" in result.stderr
    assert "Traceback" not in result.stderr


def test_missing_extras_name_the_pip_command(monkeypatch):
    monkeypatch.setattr(__main__, "EXTRAS", ("torch", "no_such_module"))
    with pytest.raises(
        SystemExit, match=r"no_such_module missing; pip install 'spotlight-relight\[export\]'"
    ):
        __main__.main()
