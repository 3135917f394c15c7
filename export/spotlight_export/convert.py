"""A float32 model folder in another precision, without the checkpoint it came from."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import onnx_ir as ir

from spotlight_export.errors import QuantisationError
from spotlight_export.folder import file_entries, new_model_folder, read_model
from spotlight_export.half import store_weights_as_half
from spotlight_export.quantise import quantise_graph
from spotlight_export.tolerances import INT8_GRAPHS
from spotlight_export.tracing import save_graph
from spotlight_spec import BackboneSpec, GraphContract, Manifest, Precision

__all__ = ["convert_graphs", "convert_model"]

Report = Callable[[str], None]


def convert_model(
    folder: Path,
    out: Path,
    precision: Precision,
    *,
    force: bool = False,
    report: Report = lambda line: None,
) -> Manifest:
    """Write a float32 model folder again with weights in another precision.

    Parameters
    ----------
    folder : Path
        Model of precision ``fp32``.
    out : Path
        Model folder to create.
    precision : {"fp16", "int8"}
    force : bool
        Replace a model that is already in ``out``.
    report : callable
        Told what is being done.

    Raises
    ------
    QuantisationError
        If the model is not float32, or cannot be quantised.
    """
    manifest = read_model(folder)
    if manifest.precision != "fp32":
        raise QuantisationError(
            f"{folder} is stored as {manifest.precision}, expected fp32; converting twice would "
            "add both losses. Export the checkpoint with --precision fp32 first"
        )
    with new_model_folder(out, force=force) as target:
        notes = convert_graphs(
            folder, target, manifest.backbone, manifest.graphs, precision, report
        )
        converted = replace(
            manifest,
            precision=precision,
            files=file_entries(target),
            parity=(),
            provenance=manifest.provenance | notes,
        )
        converted.write(target)
    return converted


def convert_graphs(
    source: Path,
    target: Path,
    spec: BackboneSpec,
    contracts: Sequence[GraphContract],
    precision: Precision,
    report: Report,
) -> dict[str, str]:
    """Write float32 graphs of one folder into another at a precision.

    Returns
    -------
    dict of str
        What the manifest should say about it.
    """
    files = [contract.file_name for contract in contracts]
    if precision == "fp16":
        return _to_half(source, target, files, report)
    return _to_int8(source, target, spec, contracts, report)


def _to_half(source: Path, target: Path, files: list[str], report: Report) -> dict[str, str]:
    kept = []
    for name in files:
        report(f"storing {name} in half precision")
        model = ir.load(source / name)
        kept += store_weights_as_half(model)
        save_graph(model, target / name)
    return {"kept float32": "; ".join(kept)} if kept else {}


def _to_int8(
    source: Path,
    target: Path,
    spec: BackboneSpec,
    contracts: Sequence[GraphContract],
    report: Report,
) -> dict[str, str]:
    # Imported here: tracing and half precision need neither onnxruntime nor the loop.
    from spotlight_export.calibrate import observe_ranges

    quantised: dict[str, Path] = {
        contract.name: source / contract.file_name
        for contract in contracts
        if contract.name in INT8_GRAPHS
    }
    exact = [contract.name for contract in contracts if contract.name not in quantised]
    ranges = observe_ranges(quantised, source / "condition_encoder.onnx", spec, report)
    counts = []
    for name, path in quantised.items():
        report(f"quantising {name}")
        counts.append(f"{quantise_graph(path, target / path.name, ranges[name])} in {name}")
    for name in exact:
        for path in sorted(source.glob(f"{name}.onnx*")):
            shutil.copyfile(path, target / path.name)
    return {"int8 layers": ", ".join(counts), "float32 graphs": ", ".join(exact)}
