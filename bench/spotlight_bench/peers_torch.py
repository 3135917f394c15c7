"""The release's networks as diffusers runs them in torch, and their plain ONNX export.

The only module of the peers that needs torch and diffusers. It is used by processes of their own
(`spotlight_bench.peers_worker`, and ``python -m spotlight_bench.peers_torch`` for the export), so
that neither is in the process that measures, or in another peer's.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from spotlight_bench.errors import MethodError

__all__ = ["main", "networks", "write_checkpoint", "write_plain", "write_prompt"]

Arrays = dict[str, npt.NDArray[Any]]
PROMPT_FILE: Final = "prompt.npy"
BRANCHES: Final = 1
"""The plain export's batch: both branches at once are no faster on a CPU."""

_PROMPT_SCRIPT: Final = """
import sys, numpy
from spotlight_export.checkpoint import open_checkpoint
numpy.save(sys.argv[3], open_checkpoint(sys.argv[1], sys.argv[2]).prompt().numpy())
"""
_CHECKPOINT_SCRIPT: Final = """
import sys
from pathlib import Path
from support import checkpoints
getattr(checkpoints, f"write_{sys.argv[1]}_checkpoint")(Path(sys.argv[2]))
"""


def write_checkpoint(folder: Path, size: str, tests: Path) -> None:
    """Write a checkpoint of random weights: ``folder/base`` and ``folder/zerocomp``.

    Parameters
    ----------
    folder : Path
    size : {"full_size", "tiny"}
    tests : Path
        The repository's ``tests``, whose support knows the published configurations.

    Raises
    ------
    MethodError
        If it fails; the message ends as its own did.
    """
    environment = os.environ | {"PYTHONPATH": str(tests)}
    _script(_CHECKPOINT_SCRIPT, size, str(folder), environment=environment)


def write_prompt(checkpoint: Path) -> None:
    """Write what the text encoder makes of the empty prompt beside the checkpoint."""
    base, control = checkpoint / "base", checkpoint / "zerocomp"
    _script(_PROMPT_SCRIPT, str(base), str(control), str(checkpoint / PROMPT_FILE))


def write_plain(checkpoint: Path, output: Path, side: int) -> None:
    """Export the networks as they are, in a process of its own: `main`."""
    _run([sys.executable, "-m", __name__, str(checkpoint), str(output), str(side)], None)


def networks(checkpoint: Path, *, half: bool, threads: int) -> dict[str, Callable[..., Arrays]]:
    """diffusers' modules under the runtime's names.

    The condition is the maps themselves: ControlNet embeds them at every step, as in the release.

    Parameters
    ----------
    checkpoint : Path
        With ``base``, ``zerocomp`` and the prompt.
    half : bool
        Under bfloat16 autocast, or in float32.
    threads : int
    """
    torch.set_num_threads(threads)
    vae, denoiser = _Vae(checkpoint), _Denoiser(checkpoint)

    def run(network: nn.Module, *inputs: npt.NDArray[Any]) -> tuple[torch.Tensor, ...]:
        cast = torch.autocast("cpu", dtype=torch.bfloat16) if half else nullcontext()
        with torch.inference_mode(), cast:
            outputs = network(*(torch.from_numpy(array) for array in inputs))
        return outputs if isinstance(outputs, tuple) else (outputs,)

    def named(names: tuple[str, ...], outputs: tuple[torch.Tensor, ...]) -> Arrays:
        return {name: tensor.float().numpy() for name, tensor in zip(names, outputs)}

    return {
        "vae_encoder": lambda image: named(("latent_mean", "latent_std"), run(vae.encoder, image)),
        "condition_encoder": lambda conditioning: {"condition": conditioning},
        "denoiser": lambda latents, timestep, condition: named(
            ("prediction",), run(denoiser, latents, timestep, condition)
        ),
        "vae_decoder": lambda latents: named(("image",), run(vae.decoder, latents)),
    }


class _Denoiser(nn.Module):
    """ControlNet and UNet as the release's pipeline calls them."""

    def __init__(self, checkpoint: Path) -> None:
        from diffusers import ControlNetModel, UNet2DConditionModel

        super().__init__()
        self.controlnet = ControlNetModel.from_pretrained(checkpoint / "zerocomp" / "controlnet")
        self.unet = UNet2DConditionModel.from_pretrained(checkpoint / "base" / "unet")
        self.register_buffer("prompt", torch.from_numpy(np.load(checkpoint / PROMPT_FILE)))
        self.eval().requires_grad_(False)

    def forward(
        self, latents: torch.Tensor, timestep: torch.Tensor, maps: torch.Tensor
    ) -> torch.Tensor:
        prompt = self.prompt.expand(latents.shape[0], -1, -1)
        down, middle = self.controlnet(
            latents, timestep, encoder_hidden_states=prompt, controlnet_cond=maps, return_dict=False
        )
        (prediction,) = self.unet(
            latents,
            timestep,
            encoder_hidden_states=prompt,
            down_block_additional_residuals=down,
            mid_block_additional_residual=middle,
            return_dict=False,
        )
        return prediction


class _Vae:
    """The two halves of diffusers' ``AutoencoderKL``."""

    def __init__(self, checkpoint: Path) -> None:
        from diffusers import AutoencoderKL

        vae = AutoencoderKL.from_pretrained(checkpoint / "base" / "vae")
        vae.eval().requires_grad_(False)
        self.encoder, self.decoder = _Encoder(vae), _Decoder(vae)


class _Encoder(nn.Module):
    def __init__(self, vae: nn.Module) -> None:
        super().__init__()
        self.vae = vae

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        posterior = self.vae.encode(image).latent_dist
        return posterior.mean, posterior.std


class _Decoder(nn.Module):
    def __init__(self, vae: nn.Module) -> None:
        super().__init__()
        self.vae = vae

    def forward(self, latents: torch.Tensor) -> torch.Tensor:
        return self.vae.decode(latents, return_dict=False)[0]


def main(checkpoint: Path, output: Path, side: int) -> None:
    """Write ``vae_encoder``, ``denoiser`` and ``vae_decoder`` as torch exports them.

    What anyone would do first: the modules themselves, the prompt a constant, one size, no more.
    """
    output.mkdir(parents=True, exist_ok=True)
    vae, denoiser = _Vae(checkpoint), _Denoiser(checkpoint)
    channels = denoiser.controlnet.config.conditioning_channels
    down = 2 ** (len(vae.encoder.vae.config.block_out_channels) - 1)
    latents = torch.randn(BRANCHES, denoiser.unet.config.in_channels, side // down, side // down)
    image, maps = torch.rand(BRANCHES, 3, side, side), torch.rand(BRANCHES, channels, side, side)
    jobs = (
        ("vae_encoder", vae.encoder, {"image": image}, ["latent_mean", "latent_std"]),
        (
            "denoiser",
            denoiser,
            {"latents": latents, "timestep": torch.tensor([500]), "condition": maps},
            ["prediction"],
        ),
        ("vae_decoder", vae.decoder, {"latents": latents}, ["image"]),
    )
    for name, network, inputs, outputs in jobs:
        torch.onnx.export(
            network,
            tuple(inputs.values()),
            output / f"{name}.onnx",
            input_names=list(inputs),
            output_names=outputs,
            dynamo=True,
            external_data=True,
            verbose=False,
        )


def _script(text: str, *arguments: str, environment: dict[str, str] | None = None) -> None:
    _run([sys.executable, "-c", text, *arguments], environment)


def _run(command: list[str], environment: dict[str, str] | None) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise MethodError(
            f"preparing the peers: {last}; `pip install 'spotlight-relight[export]'`?"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
