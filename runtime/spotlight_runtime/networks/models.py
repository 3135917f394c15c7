"""Model folders: finding them, checking them, and presenting their graphs as networks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any, Final, Literal, get_args

import numpy as np

from spotlight_runtime.arrays import FloatArray, require_finite
from spotlight_runtime.diffusion.sampler import Predict
from spotlight_runtime.diffusion.schedule import alphas_cumprod
from spotlight_runtime.errors import (
    InvalidInputError,
    ModelIntegrityError,
    UnknownModelError,
)
from spotlight_runtime.networks import openvino, sessions
from spotlight_runtime.networks.sessions import DEFAULT_PROVIDERS, Network
from spotlight_spec import MANIFEST_NAME, GraphContract, Manifest, RecordError, ScheduleSpec

__all__ = [
    "Engine",
    "LazyNetworks",
    "ModelFolder",
    "find_models",
    "open_networks",
    "predictor",
    "release",
    "resolve_model",
]


Engine = Literal["onnxruntime", "openvino", "openvino-bf16"]
"""What computes the graphs; OpenVINO is an extra, in float32 or, where the processor has it, in
bfloat16."""
SEARCH_PATH_VARIABLE: Final = "SPOTLIGHT_MODELS"
_EMBEDDED: Final = Path(__file__).parents[1] / "backbones"


@dataclass(frozen=True, slots=True)
class ModelFolder:
    """A model on disk: its folder and what its manifest says."""

    path: Path
    manifest: Manifest

    def summary(self) -> dict[str, Any]:
        """Facts for tables and reports."""
        return {
            "name": self.path.name,
            "backbone": self.manifest.backbone.name,
            "precision": self.manifest.precision,
            "layout": self.manifest.layout,
            "bytes": sum(entry.bytes for entry in self.manifest.files),
            "source": self.manifest.source.base,
            "fingerprint": self.manifest.source.fingerprint,
            "worst_parity": max((row.max_rel for row in self.manifest.parity), default=None),
        }


def find_models() -> Iterator[ModelFolder]:
    """Models that `resolve_model` knows by name, in order of preference.

    Searched are the folders in ``SPOTLIGHT_MODELS`` (separated as in ``PATH``), ``models`` in the
    working directory, and the backbones that came with the package. Folders whose manifest cannot
    be read are left out.
    """
    roots = [Path(p) for p in os.environ.get(SEARCH_PATH_VARIABLE, "").split(os.pathsep) if p]
    for root in (*roots, Path("models"), _EMBEDDED):
        for manifest in sorted(root.glob(f"*/{MANIFEST_NAME}")):
            try:
                yield ModelFolder(manifest.parent, Manifest.read(manifest.parent))
            except (RecordError, OSError):
                continue


def resolve_model(model: str | Path) -> ModelFolder:
    """Find a model by folder or by name (of its folder, or of its backbone).

    Raises
    ------
    UnknownModelError
        If there is none; the message names those there are.
    ModelIntegrityError
        If the folder's manifest is malformed.
    """
    folder = Path(model)
    if os.path.isfile(folder / MANIFEST_NAME):  # unlike Path.is_file, False for impossible names
        try:
            return ModelFolder(folder, Manifest.read(folder))
        except RecordError as error:
            raise ModelIntegrityError(f"{error}; export the model again") from error
    known = list(find_models())
    for candidate in known:
        if str(model) in (candidate.path.name, candidate.manifest.backbone.name):
            return candidate
    names = ", ".join(candidate.path.name for candidate in known) or "none"
    raise UnknownModelError(
        f"model {str(model)!r}: expected a folder with {MANIFEST_NAME} or a known name, of which "
        f"there are here: {names}. Export one with `spotlight-export`, or name its folder's parent "
        f"in {SEARCH_PATH_VARIABLE}"
    )


def open_networks(
    model: ModelFolder,
    *,
    engine: Engine = "onnxruntime",
    providers: Sequence[str] = DEFAULT_PROVIDERS,
    threads: int | None = None,
    verify_files: bool = True,
) -> LazyNetworks:
    """Networks of a model, each opened when first used.

    ``providers`` are ONNX Runtime's.

    Raises
    ------
    InvalidInputError
        If there is no such engine, no provider is named, or ``threads`` is less than 1.
    ProviderError
        If the first provider is not installed.
    ModelIntegrityError
        If a file is missing, truncated or changed since it was exported.
    """
    sessions.usable_threads(threads)  # sessions are opened later, which is late for an error
    opener: Callable[[Path, GraphContract], Network]
    if engine == "onnxruntime":
        sessions.check_providers(providers)
        opener = partial(sessions.open_graph, providers=providers, threads=threads)
    elif engine in get_args(Engine):
        opener = partial(
            openvino.open_graph,
            precision="bf16" if engine == "openvino-bf16" else "f32",
            threads=threads,
            sizes=model.manifest.backbone.own_sizes,
        )
    else:
        raise InvalidInputError(f"engine: expected {', '.join(get_args(Engine))}, got {engine!r}")
    stamps = _stamps(model)
    if verify_files and (problems := model.manifest.damaged_files(model.path)):
        raise ModelIntegrityError(
            f"{model.path}: {'; '.join(problems)}. Copy the folder again or export the model again"
        )
    return LazyNetworks(model, opener, stamps if verify_files else None)


Stamp = tuple[int, int, int]
"""Of a file: its number, size and time of change."""


def _stamps(model: ModelFolder) -> tuple[Stamp | None, ...]:
    """What tells the files of a model from what they may be later; None of one that is missing."""
    found: list[Stamp | None] = []
    for entry in model.manifest.files:
        try:
            status = os.stat(model.path / entry.path)
            found.append((status.st_ino, status.st_size, status.st_mtime_ns))
        except (OSError, ValueError):
            found.append(None)
    return tuple(found)


class LazyNetworks(Mapping[str, Network]):
    """Graph name → network; opens sessions on demand and can let them go to free memory.

    Files that were verified are verified again when a session is opened later and they have been
    written to meanwhile, so that one model never runs with another's graphs.
    """

    def __init__(
        self,
        model: ModelFolder,
        opener: Callable[[Path, GraphContract], Network],
        stamps: tuple[Stamp | None, ...] | None = None,
    ) -> None:
        self._stamps = stamps
        self._model = model
        self._opener = opener
        self._open: dict[str, Network] = {}
        self._lock = Lock()

    def __getitem__(self, name: str) -> Network:
        with self._lock:  # threads that ask at once share one session
            network = self._open.get(name)
            if network is None:
                contract = self._model.manifest.graph(name)
                self._verify_again()
                network = self._open[name] = self._opener(self._model.path, contract)
            return network  # not looked up again: another thread may have released it meanwhile

    def __iter__(self) -> Iterator[str]:
        return (contract.name for contract in self._model.manifest.graphs)

    def __len__(self) -> int:
        return len(self._model.manifest.graphs)

    def _verify_again(self) -> None:
        """Raise where a verified file is no longer what it was."""
        stamps = _stamps(self._model)
        if self._stamps is None or stamps == self._stamps:
            return
        if problems := self._model.manifest.damaged_files(self._model.path):
            raise ModelIntegrityError(
                f"{self._model.path}: changed since it was loaded: {'; '.join(problems)}. "
                "Load the model again"
            )
        self._stamps = stamps

    def release(self, *names: str) -> None:
        """Close the sessions of these graphs; they open again when used."""
        for name in names:
            self._open.pop(name, None)


def release(networks: Mapping[str, Network], *names: str) -> None:
    """Close the sessions of these graphs where they open again when used; plain functions stay."""
    if isinstance(networks, LazyNetworks):
        networks.release(*names)


def predictor(
    networks: Mapping[str, Network],
    condition: FloatArray,
    schedule: ScheduleSpec,
    *,
    batch_branches: bool = True,
    reuse: int = 1,
) -> Predict:
    """The network as the sampler knows it: ``predict(latents, timestep) -> v``.

    It is of one pass: with ``reuse`` it counts steps and keeps what they gave.

    Parameters
    ----------
    networks : mapping of str to Network
        With ``denoiser``, or with ``controlnet`` and ``unet``.
    condition : ndarray of float32, shape (branches, E, h, w)
        Encoded condition of each branch.
    schedule : ScheduleSpec
        Says what the network's output means.
    batch_branches : bool
        Run the branches in one call, or one after the other (less memory).
    reuse : int
        Evaluate the whole denoiser in every so many steps, and where a branch is asked for that
        was left out before; in the others, its shallow part on the deep features of the last whole
        evaluation (Ma et al. 2024, DeepCache).

    Returns
    -------
    callable
        Each call is one denoiser evaluation a branch it is asked for. It raises NumericalError
        where a graph's output is not finite, naming the graph; the loop adds the step.
    """
    alphas = alphas_cumprod(schedule)
    steps = count()
    kept: list[FloatArray] = []

    def ask(graph: str, timestep: int, **inputs: FloatArray) -> dict[str, FloatArray]:
        outputs = networks[graph](timestep=np.array([timestep], dtype=np.int64), **inputs)
        for name, value in outputs.items():
            require_finite(value, f"the {graph}'s {name}")
        return outputs

    def evaluate(latents: FloatArray, timestep: int, encoded: FloatArray) -> FloatArray:
        if "denoiser" in networks:
            output = ask("denoiser", timestep, latents=latents, condition=encoded)
            if reuse > 1:
                kept.append(output["deep"])
        else:
            residuals = ask("controlnet", timestep, latents=latents, condition=encoded)
            output = ask("unet", timestep, latents=latents, **residuals)
        return output["prediction"]

    def predict(latents: FloatArray, timestep: int) -> FloatArray:
        whole = next(steps) % reuse == 0 or sum(map(len, kept)) < len(latents)
        if whole:
            kept.clear()
        calls = 1 if batch_branches else len(latents)
        parts = zip(np.split(latents, calls), np.split(condition[: len(latents)], calls))
        if whole:
            outputs = [evaluate(z, timestep, c) for z, c in parts]
        else:
            deep = np.split(np.concatenate(kept)[: len(latents)], calls)
            outputs = [
                ask("denoiser_shallow", timestep, latents=z, condition=c, deep=d)["prediction"]
                for (z, c), d in zip(parts, deep)
            ]
        output = outputs[0] if calls == 1 else np.concatenate(outputs)
        return _as_v(output, latents, float(alphas[timestep]), schedule.prediction_type)

    return predict


def _as_v(output: FloatArray, z: FloatArray, alpha_bar: float, kind: str) -> FloatArray:
    """v = α ε − σ x0 from whatever the network predicts."""
    if kind == "v_prediction":
        return output
    alpha, sigma = alpha_bar**0.5, (1.0 - alpha_bar) ** 0.5
    if kind == "epsilon":
        if alpha == 0.0:
            raise InvalidInputError(
                "an epsilon-prediction backbone is undefined at zero terminal SNR (ᾱ = 0): "
                "set rescale_betas_zero_snr to false in its schedule"
            )
        # x0 = (z − σ ε) / α, so v = (ε − σ z) / α.
        return (output - sigma * z) / alpha
    # ε = (z − α x0) / σ, so v = (α z − x0) / σ.
    return (alpha * z - output) / sigma
