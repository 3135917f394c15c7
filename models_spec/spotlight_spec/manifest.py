"""A model folder's ``manifest.json``: what the files are, where they came from, how exact they are.

A model folder holds one ``*.onnx`` per graph (with external ``*.onnx.data`` where large) and this
manifest. The manifest is written last and names every file's sha256, so a folder without a valid
manifest is not a model and a changed or truncated file is noticed before it runs.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from spotlight_spec.backbone import BackboneSpec
from spotlight_spec.graph import GraphContract, GraphLayout
from spotlight_spec.records import RecordError, decode, encode, read_json, write_json

__all__ = [
    "MANIFEST_FORMAT",
    "MANIFEST_NAME",
    "FileEntry",
    "Manifest",
    "ParityRow",
    "Precision",
    "Source",
    "sha256_of",
]

MANIFEST_NAME: Final = "manifest.json"
MANIFEST_FORMAT: Final = 1
Precision = Literal["fp32", "fp16", "int8"]


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of the model folder.

    ``path`` is relative to the folder and stays inside it.
    """

    path: str
    bytes: int
    sha256: str

    def __post_init__(self) -> None:
        parts = Path(self.path).parts
        if not parts or Path(self.path).is_absolute() or ".." in parts:
            raise ValueError(f"file path {self.path!r} must stay inside the model folder")


@dataclass(frozen=True, slots=True)
class Source:
    """Checkpoint a model was exported from: folders or hub ids, and its weights' fingerprint.

    ``unet`` is set where a finetuned UNet took the place of the base model's.

    The fingerprint is the sha256 over the checkpoints' tensor names, shapes and bytes, so that
    ``verify`` refuses to compare with other weights.
    """

    base: str
    controlnet: str | None
    fingerprint: str
    unet: str | None = None


@dataclass(frozen=True, slots=True)
class ParityRow:
    """One measured comparison of an exported graph with torch in float32.

    Attributes
    ----------
    subject : str
        Graph name, or ``loop`` for a whole relight's latents.
    case : str
        Size, batch, timestep and optimisation level, for people.
    max_abs : float
        Maximum absolute error.
    max_rel : float
        Maximum absolute error over the maximum absolute value of the reference.
    tolerance : float
        Bound on ``max_rel`` for this precision; infinite tolerances are not recorded.
    """

    subject: str
    case: str
    max_abs: float
    max_rel: float
    tolerance: float


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a model folder holds.

    Attributes
    ----------
    backbone : BackboneSpec
    graphs : tuple of GraphContract
        Contract of each graph, in the order first needed.
    layout : {"fused", "split"}
    precision : {"fp32", "fp16", "int8"}
        Storage precision of the weights. Inputs and outputs are always float32.
    opset : int
        ONNX operator set of the graphs.
    files : tuple of FileEntry
    source : Source
    exporter : dict of str
        Versions of what made the files.
    parity : tuple of ParityRow
        Written by ``spotlight-export verify``; empty until then.
    licence : str or None
        Licence of the weights, where known.
    provenance : dict of str
        How the weights were made and how good they measured, for models that say so.
    """

    backbone: BackboneSpec
    graphs: tuple[GraphContract, ...]
    layout: GraphLayout
    precision: Precision
    opset: int
    files: tuple[FileEntry, ...]
    source: Source
    exporter: dict[str, str] = field(default_factory=dict)
    parity: tuple[ParityRow, ...] = ()
    licence: str | None = None
    provenance: dict[str, str] = field(default_factory=dict)
    format: int = MANIFEST_FORMAT

    @classmethod
    def read(cls, folder: Path) -> Manifest:
        """Read and check ``manifest.json`` of a model folder.

        Raises
        ------
        FileNotFoundError
            If the folder has no manifest.
        RecordError
            If the manifest is malformed.
        """
        path = folder / MANIFEST_NAME
        document = read_json(path)
        # First of all: another format has other keys, and no key would be to blame for it.
        present = document.get("format", MANIFEST_FORMAT) if isinstance(document, dict) else None
        if present != MANIFEST_FORMAT:
            raise RecordError(
                f"{path}: manifest format {present} is not {MANIFEST_FORMAT}; export the model "
                "again with this version, or install the version that wrote it"
            )
        return decode(cls, document, where=str(path))

    def write(self, folder: Path) -> None:
        """Write ``manifest.json`` atomically."""
        write_json(folder / MANIFEST_NAME, encode(self))

    def graph(self, name: str) -> GraphContract:
        """Contract of the graph called ``name``.

        Raises
        ------
        KeyError
            If the model has no such graph.
        """
        for contract in self.graphs:
            if contract.name == name:
                return contract
        raise KeyError(name)

    def damaged_files(self, folder: Path) -> list[str]:
        """Say what is wrong with the folder's files, one sentence each; empty where all is well."""
        listed = {entry.path for entry in self.files}
        problems = [
            f"{graph.file_name} is not listed, so it cannot be checked"
            for graph in self.graphs
            if graph.file_name not in listed
        ]
        for entry in self.files:
            path = folder / entry.path
            if not os.path.isfile(path):  # unlike Path.is_file, False for impossible names too
                problems.append(f"{entry.path} is missing")
            elif path.stat().st_size != entry.bytes:
                problems.append(
                    f"{entry.path} has {path.stat().st_size} bytes, expected {entry.bytes}"
                )
            elif (digest := sha256_of(path)) != entry.sha256:
                problems.append(f"{entry.path} has sha256 {digest}, expected {entry.sha256}")
        return problems


def sha256_of(path: Path) -> str:
    """Hex sha256 of a file, read in chunks."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
