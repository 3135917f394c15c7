"""What the peers run: the mini's graphs, or a checkpoint of random weights in every form."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from spotlight_bench.errors import MethodError
from spotlight_bench.peers import RELEASE, Peer
from spotlight_bench.peers_engines import HALF
from spotlight_runtime.networks.models import resolve_model

__all__ = ["SIZES", "Size", "mini_peers", "torch_peers"]

TESTS: Final = Path(__file__).parents[2] / "tests"
"""Of the repository: its support knows the published checkpoints' configurations."""
OURS: Final = (RELEASE, "balanced", "draft")


@dataclass(frozen=True, slots=True)
class Size:
    """A size of networks and pictures.

    Attributes
    ----------
    side : int
        Of the photograph.
    checkpoint : str
        What the tests' support calls it; empty: the embedded model.
    """

    side: int
    checkpoint: str = ""


SIZES: Final = {"mini": Size(256), "full": Size(512, "full_size"), "tiny": Size(64, "tiny")}


def mini_peers(openvino: bool) -> tuple[tuple[Peer, ...], Path]:
    """Engines on the embedded model's own graphs; there is no diffusers model of these.

    Errors are held against ONNX Runtime with its optimisations off, float32.

    Returns
    -------
    peers : tuple of Peer
    spec : Path
        Model folder.
    """
    folder = resolve_model("mini").path
    peers = [
        Peer("reference", "ONNX Runtime, unoptimised", "onnxruntime", folder, "unoptimised"),
        Peer("onnxruntime", "ONNX Runtime as it comes", "onnxruntime", folder),
    ]
    if openvino:
        peers += [
            Peer(f"openvino-{p}", f"OpenVINO {p}", "openvino", folder, p) for p in ("fp32", "bf16")
        ]
    peers += [Peer("ours", "SpotLight, mini", "spotlight", folder, "own", OURS)]
    if openvino:
        peers += [Peer("ours-half", "SpotLight, OpenVINO bf16", "spotlight", folder, HALF, OURS)]
    return tuple(peers), folder


def torch_peers(
    size: Size,
    work: Path,
    precisions: tuple[str, ...],
    openvino: bool,
    report: Callable[[str], None],
) -> tuple[tuple[Peer, ...], Path]:
    """Engines on one checkpoint of random weights; what is in ``work`` already is used again.

    Parameters
    ----------
    size : Size
    work : Path
        For checkpoint, plain export and our models: 20 GB at full size.
    precisions : tuple of str
        Of ours. Times are held against OpenVINO's bfloat16 where there is one, else the first.
    openvino : bool
        Whether it is installed.
    report : callable
        Told what is being done.

    Returns
    -------
    peers : tuple of Peer
    spec : Path
        Model folder of ours.

    Raises
    ------
    MethodError
        If something cannot be made.
    """
    checkpoint, plain = work / "checkpoint", work / "plain"
    _prepare(checkpoint, plain, size, report)
    ours = {precision: work / f"ours-{precision}" for precision in precisions}
    for precision, folder in ours.items():
        if not (folder / "manifest.json").is_file():
            report(f"exporting ours, {precision}")
            _export(checkpoint, folder, precision)
    peers = [
        Peer("diffusers-fp32", "diffusers fp32", "torch", checkpoint, "fp32"),
        Peer("diffusers-bf16", "diffusers bf16 autocast", "torch", checkpoint, "bf16"),
        Peer("onnxruntime", "plain export, ONNX Runtime", "onnxruntime", plain),
    ]
    if openvino:
        peers += [
            Peer(f"openvino-{p}", f"plain export, OpenVINO {p}", "openvino", plain, p)
            for p in ("fp32", "bf16")
        ]
    if openvino and "fp32" in ours:
        peers += [
            Peer("ours-half", "SpotLight, OpenVINO bf16", "spotlight", ours["fp32"], HALF, OURS)
        ]
    peers += [
        Peer(f"ours-{p}", f"SpotLight {p}", "spotlight", folder, p, OURS)
        for p, folder in ours.items()
    ]
    if "int8" in ours:  # for where memory counts
        label, plans = "SpotLight int8, low memory", ("balanced",)
        peers.append(
            Peer("ours-int8-low", label, "spotlight", ours["int8"], "int8", plans, low_memory=True)
        )
    return tuple(peers), ours[precisions[0]]


def _prepare(checkpoint: Path, plain: Path, size: Size, report: Callable[[str], None]) -> None:
    # Imported here: torch is the peers' alone.
    from spotlight_bench import peers_torch

    if not (checkpoint / "base" / "scheduler").is_dir():  # written last
        report("writing a checkpoint of random weights")
        if not TESTS.is_dir():
            raise MethodError(
                f"peers: expected the repository's tests in {TESTS}, whose support writes the "
                "checkpoint; run it from a checkout, or put base/ and zerocomp/ into "
                f"{checkpoint}"
            )
        peers_torch.write_checkpoint(checkpoint, size.checkpoint, TESTS)
    if not (checkpoint / peers_torch.PROMPT_FILE).is_file():
        report("encoding the empty prompt")
        peers_torch.write_prompt(checkpoint)
    if not (plain / "vae_decoder.onnx").is_file():  # written last
        report("exporting as torch does")
        peers_torch.write_plain(checkpoint, plain, size.side)


def _export(checkpoint: Path, folder: Path, precision: str) -> None:
    command = [sys.executable, "-m", "spotlight_export", "export", "zerocomp", "--no-verify"]
    command += ["--base", str(checkpoint / "base"), "--controlnet", str(checkpoint / "zerocomp")]
    command += ["-o", str(folder), "--precision", precision]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise MethodError(f"exporting ours, {precision}: {last}")
