"""Several lights in one picture.

Each light is a relight of its own: the picture ``out_i`` this scene would have if that light were
the one that casts the shadow. Light is additive, so under several lights each gives its share of
the radiance, in linear light and channel by channel::

    out = Σ ω_i · out_i        ω_i = w_i c_i / Σ_j w_j c_j

with the weight w and the colour c of each. The shares add up to one because the photograph already
shows all the light there is: the lights explain it, they do not add to it. Two things follow.

* On the background ``out_i = B · ρ_i`` with the light's ratio image ρ_i, so
  ``out = B · (1 − Σ ω_i (1 − ρ_i))``: each shadow takes away its own light's share and no more,
  shadows that overlap get darker, and where no shadow falls the photograph is left as it is, bit
  for bit. The shadow of an orange light beside a blue one is bluish, as it should be.
* On the object, ``Σ ω_i · out_i`` is what each light reflects, weighted by how much there is of it.

The sum runs in an order that depends on the lights alone, so permuting them changes not a bit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.lights import Vector
from spotlight_runtime.relighting.guides import GuidingShadow

__all__ = ["Mix"]


@dataclass(frozen=True, slots=True, eq=False)
class Mix:
    """How lights combine.

    Attributes
    ----------
    shares : ndarray of float32, shape (lights, 3)
        ω of each light and channel; each channel adds up to one.
    order : tuple of int
        In which they are summed up, however they were listed.
    """

    shares: npt.NDArray[np.float32]
    order: tuple[int, ...]

    @classmethod
    def of(cls, guides: Sequence[GuidingShadow]) -> Mix:
        """The mix of these lights.

        Raises
        ------
        InvalidInputError
            If in some channel no light gives anything.
        """
        if len(guides) == 1:  # a single light is all there is, whatever its weight and colour
            return cls(np.ones((1, 3), dtype=np.float32), (0,))
        order = sorted(range(len(guides)), key=lambda i: _key(guides[i]))
        # Brought to one first, numbers near the ends of float64 neither overflow nor vanish.
        weights = _of_largest(np.array([guide.weight for guide in guides]))
        colours = _of_largest(np.array([guide.colour for guide in guides]))
        given = weights[:, None] * colours
        total = given[order].sum(axis=0)
        if not (total > 0.0).all():
            dark = ", ".join(n for n, t in zip(("red", "green", "blue"), total) if t <= 0.0)
            raise InvalidInputError(
                f"lights: expected some light in every channel, got none in {dark}; "
                "raise a weight, or a colour's share of it"
            )
        return cls((given / total).astype(np.float32), tuple(order))

    def sum(self, pictures: Sequence[FloatArray]) -> FloatArray:
        """Σ ω_i · out_i of arrays of float32, shape (h, w, 3), in linear light, one a light."""
        total: FloatArray = np.zeros_like(pictures[0])
        for i in self.order:
            total += self.shares[i] * pictures[i]
        return total


def _of_largest(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Values ≥ 0 as shares of the largest; zeros where there is nothing else."""
    largest = values.max()
    return values / largest if largest > 0.0 else np.zeros(values.shape)


def _key(guide: GuidingShadow) -> tuple[float, Vector, bytes]:
    digest = hashlib.sha256()
    for shadow in (guide.positive, guide.negative):
        if shadow is not None:
            digest.update(np.ascontiguousarray(shadow).data)
    return guide.weight, guide.colour, digest.digest()
