"""Networks that remember what they answered, so that methods share what they have in common.

A relight is a pure function of its networks' answers. The methods ask them the same in part: the
picture without a shadow, for one, is the same for every direction and setting. Remembering by the
bits of the question shares all of it, whatever runs in between, and changes no bit of a picture.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from spotlight_runtime.networks.sessions import Network

__all__ = ["Memory"]

Arrays = dict[str, npt.NDArray[Any]]

MOST_BYTES: Final = 512 << 20
"""Answers kept: those of a scene and all its directions at 256×256, of one direction at 512×512."""


class Memory:
    """The latest answers of networks, by the bits of what they were asked.

    Parameters
    ----------
    most_bytes : int
        The answers that were not asked for the longest are forgotten beyond this.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._answers: OrderedDict[bytes, Arrays] = OrderedDict()

    def networks(self, networks: Mapping[str, Network]) -> dict[str, Network]:
        """The same networks, remembering.

        A ControlNet and its UNet become one ``denoiser``: the residuals that pass between them
        are a thousand times larger than its answer.
        """
        names = set(networks)
        remembering = {name: self._remembering(name, _of(networks, name)) for name in names}
        if "denoiser" not in names and {"controlnet", "unet"} <= names:
            remembering["denoiser"] = self._remembering("denoiser", _fused(networks))
            del remembering["controlnet"], remembering["unet"]
        return remembering

    def clear(self) -> None:
        """Forget everything."""
        self._answers.clear()
        self._bytes = 0

    def _remembering(self, name: str, network: Callable[..., Arrays]) -> Network:
        def ask(**inputs: npt.NDArray[Any]) -> Arrays:
            key = _key(name, inputs)
            if key in self._answers:
                self._answers.move_to_end(key)
            else:
                self._keep(key, network(**inputs))
            # Copies, for a caller may work in place.
            return {output: array.copy() for output, array in self._answers[key].items()}

        return ask

    def _keep(self, key: bytes, answer: Arrays) -> None:
        self._answers[key] = answer
        self._bytes += _size(answer)
        while self._bytes > self._most_bytes and len(self._answers) > 1:
            _, forgotten = self._answers.popitem(last=False)
            self._bytes -= _size(forgotten)


def _key(name: str, inputs: Mapping[str, npt.NDArray[Any]]) -> bytes:
    digest = hashlib.blake2b(name.encode(), digest_size=20)
    for label in sorted(inputs):
        array = np.ascontiguousarray(inputs[label])
        digest.update(f"{label} {array.dtype} {array.shape}".encode())
        digest.update(array.data)
    return digest.digest()


def _size(answer: Arrays) -> int:
    return sum(array.nbytes for array in answer.values())


def _of(networks: Mapping[str, Network], name: str) -> Callable[..., Arrays]:
    """A network that is opened when it is first asked."""

    def ask(**inputs: npt.NDArray[Any]) -> Arrays:
        return networks[name](**inputs)

    return ask


def _fused(networks: Mapping[str, Network]) -> Callable[..., Arrays]:
    def denoiser(
        latents: npt.NDArray[Any], timestep: npt.NDArray[Any], condition: npt.NDArray[Any]
    ) -> Arrays:
        step = {"latents": latents, "timestep": timestep}
        residuals = networks["controlnet"](**step, condition=condition)
        return networks["unet"](**step, **residuals)

    return denoiser
