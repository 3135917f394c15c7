"""Hold a model folder against the checkpoint it was exported from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spotlight_export.cases import Expectation, cases, expectation
from spotlight_export.checkpoint import Checkpoint, open_checkpoint
from spotlight_export.errors import FingerprintError, VerificationError
from spotlight_export.folder import read_model
from spotlight_export.reference import DenoiserReference, VaeReference
from spotlight_export.sessions import LEVELS, Network, open_graph
from spotlight_export.tolerances import LOOP_TOLERANCE, graph_tolerance
from spotlight_export.trajectory import made_up_inputs, run_loop
from spotlight_spec import Manifest, ParityRow

__all__ = ["past_tolerance", "verify_model"]

Arrays = dict[str, npt.NDArray[Any]]
SEED = 469
QUICK_LEVELS = ("disable", "all")
LOOP_SIZES = {False: ((16, 24),), True: ((16, 24), (33, 47))}


def verify_model(
    folder: Path,
    *,
    base: str | None = None,
    controlnet: str | None = None,
    unet: str | None = None,
    full: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[ParityRow, ...]:
    """Compare every graph, and a whole relight's latents, with the published torch networks.

    The reference is evaluated first and let go of before ONNX Runtime opens the graphs, so only
    one of the two is in memory at a time. The rows also go into the folder's manifest.

    Parameters
    ----------
    folder : Path
        Model folder.
    base, controlnet, unet : str, optional
        Where the checkpoint is now, if not where the manifest says.
    full : bool
        More sizes, batches and timesteps, and every optimisation level of ONNX Runtime.
    report : callable
        Told what is being done.

    Returns
    -------
    tuple of ParityRow

    Raises
    ------
    ModelFolderError
        If the folder is no model or is damaged.
    VerificationError
        If ONNX Runtime refuses a graph, or a result is not finite.
    FingerprintError
        If the checkpoint is not the one the model was exported from.
    """
    manifest = read_model(folder)
    expected, loops = _expect(_source(manifest, base, controlnet, unet), manifest, full, report)
    levels = tuple(LEVELS) if full else QUICK_LEVELS
    rows = []
    for contract in manifest.graphs:
        for level in levels:
            report(f"running {contract.name}, optimisation level {level}")
            network = open_graph(folder / contract.file_name, level)
            for entry in (e for e in expected if e.graph == contract.name):
                worst = _errors(
                    contract.name, str(entry.case), network(**entry.inputs), entry.outputs
                )
                tolerance = graph_tolerance(contract.name, manifest.precision)
                rows.append(ParityRow(contract.name, f"{level} · {entry.case}", *worst, tolerance))
            del network
    rows += _run_loops(folder, manifest, loops, report)
    replace(manifest, parity=tuple(rows)).write(folder)
    return tuple(rows)


def past_tolerance(rows: tuple[ParityRow, ...]) -> list[ParityRow]:
    """Rows that are not within their tolerance."""
    return [row for row in rows if not row.max_rel <= row.tolerance]


def _source(
    manifest: Manifest, base: str | None, controlnet: str | None, unet: str | None
) -> Checkpoint:
    source = manifest.source
    controlnet = controlnet or source.controlnet
    if controlnet is None:
        raise VerificationError(
            f"backbone {manifest.backbone.name!r} was not exported from a ControlNet checkpoint; "
            "there is no published forward pass to verify it against"
        )
    return open_checkpoint(base or source.base, controlnet, unet or source.unet)


def _expect(
    checkpoint: Checkpoint, manifest: Manifest, full: bool, report: Callable[[str], None]
) -> tuple[list[Expectation], list[tuple[Any, Any]]]:
    """Reference's outputs for every case, and its latents after whole loops."""
    report("loading the reference")
    vae, denoiser = VaeReference(checkpoint), DenoiserReference(checkpoint)
    if (fingerprint := checkpoint.fingerprint()) != manifest.source.fingerprint:
        raise FingerprintError(
            f"the checkpoint's weights have fingerprint {fingerprint[:12]}…, the model was "
            f"exported from {manifest.source.fingerprint[:12]}…; pass --base and --controlnet of "
            "the checkpoint it was exported from, or export it again"
        )
    spec, rng = manifest.backbone, np.random.default_rng(SEED)
    expected = []
    for contract in manifest.graphs:
        for case in cases(contract.name, spec, full=full):
            report(f"reference: {contract.name} at {case}")
            expected.append(expectation(contract.name, case, spec, vae, denoiser, rng))
    loops = []
    for size in LOOP_SIZES[full]:
        report(f"reference: {spec.schedule.steps}-step loop at {size[0]}×{size[1]}")
        inputs = made_up_inputs(spec, size, rng)
        loops.append((inputs, run_loop(denoiser.networks(), inputs.conditioning, inputs, spec)))
    return expected, loops


def _run_loops(
    folder: Path,
    manifest: Manifest,
    loops: list[tuple[Any, Any]],
    report: Callable[[str], None],
) -> list[ParityRow]:
    networks: dict[str, Network] = {
        contract.name: open_graph(folder / contract.file_name)
        for contract in manifest.graphs
        if not contract.name.startswith("vae")
    }
    rows = []
    for inputs, expected in loops:
        height, width = expected.shape[-2:]
        case = f"all · {height}×{width} · {manifest.backbone.schedule.steps} steps"
        report(f"running the loop at {height}×{width}")
        condition = networks["condition_encoder"](conditioning=inputs.conditioning)["condition"]
        latents = run_loop(networks, condition, inputs, manifest.backbone)
        worst = _errors("loop", case, {"latents": latents}, {"latents": expected})
        rows.append(ParityRow("loop", case, *worst, LOOP_TOLERANCE[manifest.precision]))
    return rows


def _errors(graph: str, case: str, got: Arrays, expected: Arrays) -> tuple[float, float]:
    """Largest absolute error, and largest over the reference's largest value, of all outputs."""
    for name, array in (*got.items(), *expected.items()):
        if not np.isfinite(array).all():
            raise VerificationError(
                f"{graph} at {case}: {name} is not finite; the weights overflow. Check the "
                "checkpoint, or export with --precision fp32"
            )
    absolute = {name: float(np.abs(got[name] - array).max()) for name, array in expected.items()}
    relative = (absolute[name] / float(np.abs(expected[name]).max()) for name in expected)
    return max(absolute.values()), max(relative)
