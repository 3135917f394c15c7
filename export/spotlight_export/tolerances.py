"""How exact an exported model must be, by the precision its weights are stored in.

All are bounds on the maximum absolute error over the reference's maximum absolute value.
"""

from __future__ import annotations

from typing import Final

from spotlight_spec import Precision

__all__ = ["GRAPH_TOLERANCE", "INT8_GRAPHS", "LOOP_TOLERANCE", "graph_tolerance"]

INT8_GRAPHS: Final = ("denoiser", "controlnet", "unet")
"""Graphs whose arithmetic int8 changes; the others run once a relight and stay float32."""

GRAPH_TOLERANCE: Final[dict[Precision, float]] = {
    # Two float32 implementations that only order their sums differently stay within 3e-5.
    "fp32": 1e-4,
    # Weights rounded to 11 bits: 2^-12 a weight, which a deep network amplifies several times.
    "fp16": 1e-2,
    # Weights and activations on 256 levels: a few percent of the range is what int8 costs.
    "int8": 2.5e-1,
}

LOOP_TOLERANCE: Final[dict[Precision, float]] = {
    # Each step starts from the error of the last, but DDIM contracts it as fast as it grows.
    "fp32": 1e-4,
    "fp16": 3e-2,
    "int8": 5e-1,
}


def graph_tolerance(graph: str, precision: Precision) -> float:
    """Bound on a graph's relative error."""
    exact = precision == "int8" and graph not in INT8_GRAPHS
    return GRAPH_TOLERANCE["fp32" if exact else precision]
