"""Seeded noise in named streams.

Every random array of a relight has a stream of its own, derived from the seed and the stream's
name. What a plan skips or reorders therefore never changes the numbers of what it runs: the same
seed gives the same image.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from spotlight_runtime.errors import InvalidInputError

__all__ = ["MAX_SEED", "checked_seed", "gaussian"]

MAX_SEED: Final = 2**63 - 1
_STREAMS: Final = {"initial": 0, "posterior": 1, "step": 2}


def checked_seed(seed: int) -> int:
    """The seed as Python's own integer.

    Raises
    ------
    InvalidInputError
        If it is no whole number from 0 to 2⁶³ − 1.
    """
    if (
        isinstance(seed, bool)
        or not isinstance(seed, int | np.integer)
        or not 0 <= seed <= MAX_SEED
    ):
        raise InvalidInputError(f"seed: expected a whole number from 0 to 2**63 - 1, got {seed!r}")
    return int(seed)


def gaussian(
    seed: int,
    stream: Literal["initial", "posterior", "step"],
    shape: tuple[int, ...],
    index: int = 0,
) -> npt.NDArray[np.float32]:
    """Unit Gaussian noise of one stream.

    Parameters
    ----------
    seed : int
        In [0, 2⁶³ − 1].
    stream : {"initial", "posterior", "step"}
        Starting latents; VAE posterior sample of a branch; fresh noise of a step.
    shape : tuple of int
        Shape of the array.
    index : int
        Which branch or step.

    Returns
    -------
    ndarray of float32
        Samples of N(0, 1).
    """
    # A spawn key, unlike a longer list of entropy, is kept apart from the words of a large seed.
    entropy = np.random.SeedSequence(checked_seed(seed), spawn_key=(_STREAMS[stream], index))
    return np.random.default_rng(entropy).standard_normal(shape, dtype=np.float32)
