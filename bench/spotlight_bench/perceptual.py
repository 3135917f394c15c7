"""ST-LPIPS, the shift-tolerant learned perceptual distance. The only module here that needs torch.

The weights (AlexNet) come with the package stlpips-pytorch.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any, Final

import numpy as np
import torch

from spotlight_runtime.arrays import FloatArray

__all__ = ["PerceptualDistance"]

BATCH: Final = 9
"""Pictures at a time: at 512×512 a picture takes 0.5 GB on its way."""
_UNUSED: Final = {"torchvision": "models", "IPython": "embed", "torchsummary": "summary"}
"""Imported by the package, undeclared, for other networks and for debugging, with the name it asks
for: the shift-tolerant AlexNet uses none of them."""


class PerceptualDistance:
    """ST-LPIPS as maps of the size of the pictures.

    Parameters
    ----------
    threads : int, optional
        Torch's threads; they are the process's.
    """

    def __init__(self, threads: int | None = None) -> None:
        if threads is not None:
            torch.set_num_threads(threads)
        with _placeholders():
            from stlpips_pytorch.stlpips import LPIPS
        network: Any = LPIPS(net="alex", variant="shift_tolerant", spatial=True, verbose=False)
        # A fifth faster on a CPU, the same to 1e-6.
        self._network = network.eval().to(memory_format=torch.channels_last)

    def __call__(self, pictures: FloatArray, truth: FloatArray) -> FloatArray:
        """Distance of each pixel's neighbourhood from the truth's.

        Parameters
        ----------
        pictures : ndarray of float32, shape (N, H, W, 3)
            sRGB-encoded, in [0, 1].
        truth : ndarray of float32, shape (H, W, 3)
            Goes through the network once a batch.

        Returns
        -------
        ndarray of float32, shape (N, H, W)
        """
        reference = _tensor(truth[None])
        with torch.inference_mode():
            maps = [
                self._network(_tensor(pictures[first : first + BATCH]), reference)[:, 0].numpy()
                for first in range(0, len(pictures), BATCH)
            ]
        return np.concatenate(maps)


def _tensor(images: FloatArray) -> torch.Tensor:
    """Images in [0, 1], channels last, as the network wants them: in [−1, 1], channels first."""
    scaled = np.ascontiguousarray(images, dtype=np.float32) * np.float32(2.0) - np.float32(1.0)
    return torch.from_numpy(scaled).permute(0, 3, 1, 2)


@contextmanager
def _placeholders() -> Iterator[None]:
    """Stand in for packages that are imported but not used, where they are not installed."""
    absent = [name for name in _UNUSED if importlib.util.find_spec(name) is None]
    for name in absent:
        module = ModuleType(name)
        setattr(module, _UNUSED[name], None)
        sys.modules[name] = module
    try:
        yield
    finally:
        for name in absent:
            sys.modules.pop(name, None)
