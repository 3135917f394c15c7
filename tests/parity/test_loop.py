"""SpotLight's whole loop over 20 steps, at every step of every point of the grid.

The oracle is float64 from the scene's maps to the last latents. In float64 the runtime must be the
oracle to rounding, which leaves no room for another formula; in float32, over torch or ONNX, the
networks' own rounding is what remains, far below the 1e-4 that is promised.
"""

from __future__ import annotations

from itertools import product

import pytest
from oracle.loop import Fidelity, Knobs

from .measure import Tolerance, assert_within, relative_error
from .shadows import NEGATIVES, Negative
from .trajectories import STEPS, Run, Trajectories

GRID = list(product((1.0, 3.0, 7.0), (0.0, 0.05, 0.2), NEGATIVES, ("release", "paper")))
DIAGONAL = [point for point in GRID if point[:2] in ((1.0, 0.2), (3.0, 0.05), (7.0, 0.0))]
CASES = [
    *(("onnx", *point) for point in GRID),
    *(("torch", *point) for point in DIAGONAL),
    *(("float64", *point) for point in DIAGONAL),
]
SINGLE = Tolerance(relative=1e-5, absolute=5e-5)
TOLERANCE = {
    "onnx": SINGLE,
    "torch": SINGLE,
    "float64": Tolerance(relative=1e-12, absolute=1e-11),
}


@pytest.mark.parametrize(("networks", "gamma", "beta", "negative", "fidelity"), CASES)
def test_the_runtime_computes_the_papers_loop(
    trajectories: Trajectories,
    networks: str,
    gamma: float,
    beta: float,
    negative: Negative,
    fidelity: Fidelity,
) -> None:
    run = Run(Knobs(gamma=gamma, beta=beta, fidelity=fidelity), negative)
    expected, actual = trajectories.oracle(run), trajectories.runtime(networks, run)
    assert len(actual) == len(expected) == STEPS
    for step, (ours, theirs) in enumerate(zip(actual, expected)):
        assert ours.dtype == ("float64" if networks == "float64" else "float32")
        assert_within(TOLERANCE[networks], ours, theirs, f"step {step}")


@pytest.mark.parametrize(("gamma", "beta", "negative", "fidelity"), GRID)
def test_the_runtime_is_a_loop_around_diffusers_ddim(
    trajectories: Trajectories, gamma: float, beta: float, negative: Negative, fidelity: Fidelity
) -> None:
    run = Run(Knobs(gamma=gamma, beta=beta, fidelity=fidelity), negative)
    pairs = zip(trajectories.runtime("onnx", run), trajectories.diffusers(run), strict=True)
    for step, (ours, theirs) in enumerate(pairs):
        assert_within(SINGLE, ours, theirs, f"step {step}")


@pytest.mark.parametrize(
    "run",
    [
        Run(Knobs(gamma=1.0), "opposite"),
        Run(Knobs(gamma=7.0), "opposite"),
        Run(Knobs(beta=0.0), "opposite"),
        Run(Knobs(beta=0.2), "opposite"),
        Run(Knobs(fidelity="paper"), "opposite"),
        Run(Knobs(), "none"),
        Run(Knobs(), "second drawing"),
    ],
)
def test_every_knob_moves_the_latents_far_beyond_the_tolerance(
    trajectories: Trajectories, run: Run
) -> None:
    usual = trajectories.oracle(Run(Knobs(), "opposite"))
    error = relative_error(trajectories.oracle(run)[-1][0], usual[-1][0])
    assert error > 1000.0 * SINGLE.relative
