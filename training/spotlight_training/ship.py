"""From finished trainings to the model folder the runtime embeds.

The graphs go through the same exporter as a published checkpoint's, and are held against torch
before the folder appears.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from spotlight_export.convert import convert_graphs
from spotlight_export.folder import file_entries, new_model_folder
from spotlight_export.jobs import GraphJob
from spotlight_export.sessions import open_graph
from spotlight_export.tolerances import LOOP_TOLERANCE, graph_tolerance
from spotlight_export.tracing import OPSET, save_graph, trace
from spotlight_export.trajectory import made_up_inputs, made_up_maps, run_loop
from spotlight_spec import (
    BackboneSpec,
    GraphContract,
    Manifest,
    ParityRow,
    Precision,
    Source,
    graph_contracts,
    intrinsics_contract,
)
from spotlight_training.networks import VAE, Denoiser, IntrinsicsNet
from spotlight_training.objectives import Renderer

__all__ = ["ship"]

Report = Callable[[str], None]
LICENCE: Final = "Apache-2.0"
TOOLS: Final = ("spotlight-relight", "torch", "onnx", "onnxscript")
TRACE_LATENT: Final = (12, 20)
"""Latent size to trace at: nowhere one pixel small, and no two sides alike."""
CHECKED_LATENTS: Final = ((32, 32), (24, 40), (33, 47))
"""Latent sizes each graph is compared at, odd ones included."""
PHOTOGRAPH: Final = 32
"""Pixels the estimator's sides are multiples of."""
SEED: Final = 469


def ship(
    renderer: Renderer,
    estimator: IntrinsicsNet,
    spec: BackboneSpec,
    out: Path,
    provenance: dict[str, str],
    *,
    precision: Precision = "fp16",
    force: bool = False,
    report: Report = lambda line: None,
) -> Manifest:
    """Export renderer and estimator as one model folder.

    Parameters
    ----------
    renderer : Renderer
        Trained, with its VAE.
    estimator : IntrinsicsNet
    spec : BackboneSpec
    out : Path
        Folder to create.
    provenance : dict of str
        How the weights were made and how good they measured, for the manifest.
    precision : {"fp32", "fp16", "int8"}
        How weights are stored.
    force : bool
        Replace a model that is already there.
    report : callable
        Told what is being done.

    Raises
    ------
    ValueError
        If a graph is further from torch than its precision allows; nothing is left behind.
    """
    contracts: list[GraphContract] = []
    with new_model_folder(out, force=force) as folder:
        traced = folder / "float32"
        traced.mkdir()
        for job in _jobs(renderer, estimator, spec):
            report(f"tracing {job.contract.name}")
            save_graph(
                trace(job.network, job.example, job.contract), traced / job.contract.file_name
            )
            contracts.append(job.contract)
        notes = convert_graphs(traced, folder, spec, contracts, precision, report)
        for file in traced.iterdir():
            file.unlink()
        traced.rmdir()
        rows = tuple(_parity(folder, contracts, renderer, estimator, spec, precision, report))
        if past := [row for row in rows if not row.max_rel <= row.tolerance]:
            raise ValueError(
                f"{past[0].subject} at {past[0].case} differs from torch by {past[0].max_rel:.1e}, "
                f"allowed are {past[0].tolerance:.0e}; ship with --precision fp32 to see whether "
                "the graph or its precision is to blame"
            )
        manifest = Manifest(
            backbone=spec,
            graphs=tuple(contracts),
            layout="fused",
            precision=precision,
            opset=OPSET,
            files=file_entries(folder),
            source=Source("spotlight-train", None, _fingerprint(renderer, estimator)),
            exporter={tool: version(tool) for tool in TOOLS},
            parity=rows,
            licence=LICENCE,
            provenance=provenance | notes,
        )
        manifest.write(folder)
    return manifest


class _Encoder(nn.Module):
    def __init__(self, vae: VAE) -> None:
        super().__init__()
        self.vae = vae

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_variance = self.vae.encode(image)
        return mean, torch.exp(0.5 * log_variance)


class _Decoder(nn.Module):
    def __init__(self, vae: VAE) -> None:
        super().__init__()
        self.vae = vae

    def forward(self, latents: Tensor) -> Tensor:
        return self.vae.decode(latents)


class _Whole(nn.Module):
    def __init__(self, denoiser: Denoiser) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(
        self, latents: Tensor, timestep: Tensor, condition: Tensor
    ) -> tuple[Tensor, Tensor]:
        return self.denoiser.whole(latents, timestep, condition)


class _Shallow(nn.Module):
    def __init__(self, denoiser: Denoiser) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(self, latents: Tensor, timestep: Tensor, condition: Tensor, deep: Tensor) -> Tensor:
        return self.denoiser.shallow(latents, timestep, condition, deep)


def _jobs(renderer: Renderer, estimator: IntrinsicsNet, spec: BackboneSpec) -> Iterator[GraphJob]:
    generator = torch.Generator().manual_seed(SEED)
    contracts = {
        contract.name: contract
        for contract in graph_contracts(
            spec,
            condition_channels=renderer.condition.channels,
            deep_channels=renderer.denoiser.deep_channels,
        )
    }
    height, width = TRACE_LATENT
    pixels = (height * spec.latent.downscale, width * spec.latent.downscale)
    image = torch.rand(2, 3, *pixels, generator=generator)
    latents = torch.randn(2, spec.latent.channels, *TRACE_LATENT, generator=generator)
    maps = torch.rand(2, spec.conditioning_channels, *pixels, generator=generator)
    timestep = torch.tensor([spec.schedule.num_train_timesteps // 2])
    yield GraphJob(contracts["vae_encoder"], _Encoder(renderer.vae), (image,))
    yield GraphJob(contracts["condition_encoder"], renderer.condition, (maps,))
    with torch.no_grad():
        condition = renderer.condition(maps)
        _, deep = renderer.denoiser.whole(latents, timestep, condition)
    inputs = (latents, timestep, condition)
    yield GraphJob(contracts["denoiser"], _Whole(renderer.denoiser), inputs)
    shallow = contracts["denoiser_shallow"]
    yield GraphJob(shallow, _Shallow(renderer.denoiser), (*inputs, deep))
    yield GraphJob(contracts["vae_decoder"], _Decoder(renderer.vae), (latents,))
    photograph = torch.rand(2, 3, 2 * PHOTOGRAPH, 3 * PHOTOGRAPH, generator=generator)
    yield GraphJob(intrinsics_contract(), estimator, (photograph,))


@torch.no_grad()
def _parity(
    folder: Path,
    contracts: list[GraphContract],
    renderer: Renderer,
    estimator: IntrinsicsNet,
    spec: BackboneSpec,
    precision: Precision,
    report: Report,
) -> Iterator[ParityRow]:
    """Compare every graph, and a whole relight's latents, with torch in float32."""
    rng = np.random.default_rng(SEED)
    networks = {c.name: open_graph(folder / c.file_name) for c in contracts}
    reference = {
        "vae_encoder": _Encoder(renderer.vae),
        "condition_encoder": renderer.condition,
        "denoiser": _Whole(renderer.denoiser),
        "denoiser_shallow": _Shallow(renderer.denoiser),
        "vae_decoder": _Decoder(renderer.vae),
        "intrinsics": estimator,
    }

    def torch_network(name: str) -> Callable[..., dict[str, Any]]:
        contract = next(c for c in contracts if c.name == name)

        def call(**inputs: Any) -> dict[str, Any]:
            arrays = (torch.from_numpy(inputs[tensor.name]) for tensor in contract.inputs)
            outputs = reference[name](*arrays)
            outputs = outputs if isinstance(outputs, tuple) else (outputs,)
            return {tensor.name: y.numpy() for tensor, y in zip(contract.outputs, outputs)}

        return call

    last = spec.schedule.num_train_timesteps - 1
    for contract in contracts:
        report(f"comparing {contract.name} with torch")
        expected_of = torch_network(contract.name)
        for number, size in enumerate(CHECKED_LATENTS):
            timestep = (last, last // 2, 0)[number]
            inputs = _inputs(contract, spec, size, 1 + number % 2, timestep, rng)
            if "condition" in inputs:  # its channels have ranges, which maps alone give
                inputs |= torch_network("condition_encoder")(conditioning=inputs["condition"])
            got, expected = networks[contract.name](**inputs), expected_of(**inputs)
            errors = [float(np.abs(got[key] - expected[key]).max()) for key in expected]
            scales = [float(np.abs(expected[key]).max()) for key in expected]
            yield ParityRow(
                contract.name,
                f"{size[0]}×{size[1]} latents" + (f", t {timestep}" * (len(inputs) > 1)),
                max(errors),
                max(error / scale for error, scale in zip(errors, scales)),
                graph_tolerance(contract.name, precision),
            )
    report("comparing whole relights with torch")
    inputs = made_up_inputs(spec, CHECKED_LATENTS[0], rng)
    loops = []
    for encode, denoise in (
        (networks["condition_encoder"], networks["denoiser"]),
        (torch_network("condition_encoder"), torch_network("denoiser")),
    ):
        condition = encode(conditioning=inputs.conditioning)["condition"]
        loops.append(run_loop({"denoiser": denoise}, condition, inputs, spec))
    error = float(np.abs(loops[0] - loops[1]).max())
    yield ParityRow(
        "loop",
        f"{spec.schedule.steps} steps",
        error,
        error / float(np.abs(loops[1]).max()),
        LOOP_TOLERANCE[precision],
    )


def _inputs(
    contract: GraphContract,
    spec: BackboneSpec,
    size: tuple[int, int],
    batch: int,
    timestep: int,
    rng: np.random.Generator,
) -> dict[str, Any]:
    pixels = tuple(side * spec.latent.downscale for side in size)
    if contract.name == "intrinsics":
        pixels = tuple(side // PHOTOGRAPH * PHOTOGRAPH for side in pixels)
    values = {
        "image": lambda: rng.uniform(0.0, 1.0, (batch, 3, *pixels)).astype(np.float32),
        "conditioning": lambda: made_up_maps(spec, size, batch, rng),
        "latents": lambda: rng.standard_normal(
            (batch, spec.latent.channels, *size), dtype=np.float32
        ),
        "timestep": lambda: np.array([timestep], np.int64),
        "condition": lambda: made_up_maps(spec, size, batch, rng),
        "deep": lambda: rng.standard_normal(
            (batch, contract.inputs[-1].shape[1], *size), dtype=np.float32
        ),
    }
    return {tensor.name: values[tensor.name]() for tensor in contract.inputs}


def _fingerprint(*networks: nn.Module) -> str:
    """sha256 over tensor names, shapes and bytes."""
    digest = hashlib.sha256()
    for network in networks:
        for name, tensor in network.state_dict().items():
            digest.update(f"{name} {tuple(tensor.shape)}".encode())
            digest.update(tensor.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
