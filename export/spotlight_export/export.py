"""Export a backbone: checkpoint in, model folder out."""

from __future__ import annotations

import gc
import shutil
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from spotlight_export.adoption import adopt_configuration
from spotlight_export.checkpoint import open_checkpoint
from spotlight_export.convert import convert_graphs
from spotlight_export.errors import ExportError
from spotlight_export.folder import file_entries, new_model_folder
from spotlight_export.jobs import graph_jobs
from spotlight_export.tracing import OPSET, save_graph, trace
from spotlight_spec import (
    BACKBONES,
    BackboneSpec,
    GraphContract,
    GraphLayout,
    Manifest,
    Precision,
    Source,
)

__all__ = ["export_backbone", "find_backbone"]

TOOLS = ("spotlight-relight", "torch", "diffusers", "transformers", "onnx", "onnxscript")


def export_backbone(
    name: str,
    base: str | Path,
    controlnet: str | Path,
    out: str | Path,
    *,
    unet: str | Path | None = None,
    precision: Precision = "fp32",
    layout: GraphLayout = "fused",
    force: bool = False,
    report: Callable[[str], None] = lambda line: None,
    warn: Callable[[str], None] = lambda line: None,
) -> Manifest:
    """Export a checkpoint as a model folder.

    Parameters
    ----------
    name : str
        Backbone, a key of `spotlight_spec.BACKBONES`; ``zerocomp`` means ``zerocomp-openrooms``.
    base, controlnet : str or Path
        Checkpoint folders in the layout diffusers writes, or hub ids.
    out : str or Path
        Model folder to create.
    unet : str or Path, optional
        Finetuned UNet to use instead of the base model's.
    precision : {"fp32", "fp16", "int8"}
        How the weights are stored.
    layout : {"fused", "split"}
        ControlNet and UNet as one graph or as two.
    force : bool
        Replace a model that is already in ``out``.
    report, warn : callable
        Told what is being done, and what about the checkpoint deserves attention.

    Returns
    -------
    Manifest
        As written to ``out/manifest.json``.

    Raises
    ------
    ExportError
        If anything about the input or the export is wrong; nothing is left behind then.
    """
    checkpoint = open_checkpoint(str(base), str(controlnet), str(unet) if unet else None)
    spec, warnings = adopt_configuration(
        find_backbone(name), checkpoint.config("vae"), checkpoint.config("scheduler")
    )
    for line in warnings:
        warn(line)
    contracts: list[GraphContract] = []
    with new_model_folder(Path(out), force=force) as folder:
        traced = folder if precision == "fp32" else folder / "float32"
        traced.mkdir(exist_ok=True)
        for job in graph_jobs(checkpoint, spec, layout):
            report(f"tracing {job.contract.name}")
            model = trace(job.network, job.example, job.contract)
            report(f"writing {job.contract.file_name}")
            save_graph(model, traced / job.contract.file_name)
            contracts.append(job.contract)
            del job, model
            gc.collect()  # traced graphs are cyclic; without this two models' weights coexist
        notes = {}
        if traced != folder:
            notes = convert_graphs(traced, folder, spec, contracts, precision, report)
            shutil.rmtree(traced)
        manifest = Manifest(
            backbone=spec,
            graphs=tuple(contracts),
            layout=layout,
            precision=precision,
            opset=OPSET,
            files=file_entries(folder),
            source=Source(
                str(base), str(controlnet), checkpoint.fingerprint(), str(unet) if unet else None
            ),
            exporter={tool: version(tool) for tool in TOOLS},
            provenance=notes,
        )
        manifest.write(folder)
    return manifest


def find_backbone(name: str) -> BackboneSpec:
    """Specification of a backbone by name.

    Raises
    ------
    ExportError
        If there is none of that name.
    """
    full = "zerocomp-openrooms" if name == "zerocomp" else name
    if full not in BACKBONES:
        raise ExportError(f"unknown backbone {name!r}; expected one of {', '.join(BACKBONES)}")
    return BACKBONES[full]
