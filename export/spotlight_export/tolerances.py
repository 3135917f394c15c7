"""How exact an exported model must be, by the precision its weights are stored in.

All are bounds on the maximum absolute error over the reference's maximum absolute value.
"""

from __future__ import annotations

from typing import Final

from spotlight_spec import Precision

__all__ = ["GRAPH_TOLERANCE", "INT8_GRAPHS", "LOOP_TOLERANCE", "graph_tolerance"]

INT8_GRAPHS: Final = ("denoiser", "denoiser_shallow", "controlnet", "unet")
"""Graphs whose arithmetic int8 changes; the others run once a relight and stay float32."""

GRAPH_TOLERANCE: Final[dict[Precision, float]] = {
    # Two float32 implementations that only order their sums differently stay within 3e-5.
    "fp32": 1e-4,
    # Weights rounded to 11 bits: 2^-12 a weight, up to 5e-3 after a whole network.
    "fp16": 1e-2,
    # 256 levels for weights and activations: 5e-2 to 6e-2 whatever the size of the network.
    "int8": 1.5e-1,
}
"""Two to three times the errors measured with random weights, for checkpoints less tame."""

LOOP_TOLERANCE: Final[dict[Precision, float]] = {
    # A step's error is scaled down with its share of the noise: loops end closer than they step.
    "fp32": 1e-4,
    "fp16": 1e-2,
    "int8": 1e-1,
}
"""Measured: 5e-7, 5e-4 and 2e-2 after 20 steps."""


def graph_tolerance(graph: str, precision: Precision) -> float:
    """Bound on a graph's relative error."""
    exact = precision == "int8" and graph not in INT8_GRAPHS
    return GRAPH_TOLERANCE["fp32" if exact else precision]
