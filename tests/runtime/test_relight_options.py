"""Options are checked once, when they are made."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from support.onnx_backbone import tiny_spec

from spotlight_runtime import RelightOptions
from spotlight_runtime.errors import InvalidInputError


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("gamma", v) for v in (-0.1, 20.1, np.nan, np.inf, "3", None, 3j)),
        *(("beta", v) for v in (-1e-9, 1.01, np.nan, "0.05", None)),
        *(("guidance_rescale", v) for v in (-0.1, 1.1, np.nan)),
        *(("shadow_opacity", v) for v in (-0.1, 1.1, np.nan)),
        *(("seed", v) for v in (-1, 2**63, 1.5, "1", None, True, np.nan)),
        *(("steps", v) for v in (0, -1, 2.5, "20", True, np.nan)),
        *(("gamma", v) for v in (True, 10**400, np.float32(21), np.array([3.0]))),
        *(("reuse", v) for v in (0, 1.0, None, True, np.int64(0))),
        *(("guidance_interval", v) for v in (0.5, None, (0.0,), (0.6, 0.4), "01", (0.0, "1"))),
        *(("fidelity", v) for v in ("Paper", "", None, 1)),
        *(("solver", v) for v in ("euler", "", None, "DDIM")),
        *(("window", v) for v in ("Auto", "", None, 512)),
        *(("detail", v) for v in ("Maps", "", None, True)),
    ],
)
def test_option_outside_its_domain_is_named(name, value):
    with pytest.raises(InvalidInputError, match=f"^{name}: expected "):
        RelightOptions(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("gamma", v) for v in (0, 0.0, 1, 3.0, 20, np.float64(3.0))),
        *(("beta", v) for v in (0, 0.0, 0.05, 1)),
        *(("seed", v) for v in (0, 469, 2**63 - 1, np.int64(3), np.uint32(3))),
        *(("steps", v) for v in (None, 1, 1000)),
        *(("gamma", v) for v in (np.int64(3), np.float32(3))),
        *((name, np.int64(3)) for name in ("steps", "plain_steps", "reuse")),
        ("guidance_interval", [np.float32(0.5), 1]),
        *(("solver", v) for v in ("ddim", "dpmpp_2m", "unipc")),
        *(("fidelity", v) for v in ("paper", "release")),
        *(("denoise", v) for v in (None, True, False)),
        *(("window", v) for v in ("auto", "frame")),
        *(("detail", v) for v in ("auto", "renderer", "maps")),
    ],
)
def test_options_within_their_domain_can_be_reported(name, value):
    options = RelightOptions(**{name: value})
    assert json.loads(json.dumps(asdict(options)))[name] == value


def test_steps_default_to_the_backbones():
    assert RelightOptions().steps_for(tiny_spec(steps=7)) == 7
    assert RelightOptions(steps=3).steps_for(tiny_spec(steps=7)) == 3


def test_defaults_are_the_papers():
    options = RelightOptions()
    assert (options.gamma, options.beta, options.fidelity) == (3.0, 0.05, "paper")
    assert (options.solver, options.shadow_opacity, options.guidance_rescale) == ("ddim", 1.0, 0.0)
