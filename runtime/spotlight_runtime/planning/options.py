"""How to relight: the options, checked once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Final, Literal, TypedDict, get_args

from spotlight_runtime.diffusion.blending import weight_of_steps
from spotlight_runtime.diffusion.noise import checked_seed
from spotlight_runtime.diffusion.sampler import Fidelity
from spotlight_runtime.diffusion.solvers import SOLVERS, SolverName
from spotlight_runtime.errors import InvalidInputError
from spotlight_runtime.geometry.lights import as_float
from spotlight_spec import BackboneSpec

__all__ = ["Detail", "OptionChanges", "RelightOptions", "WindowMode"]

Detail = Literal["auto", "renderer", "maps"]
WindowMode = Literal["auto", "frame", "tight", "coarse"]

_LIMITS: Final = {
    "gamma": 20.0,
    "beta": 1.0,
    "guidance_rescale": 1.0,
    "shadow_opacity": 1.0,
}


@dataclass(frozen=True, slots=True)
class RelightOptions:
    """How to relight.

    Attributes
    ----------
    gamma : float
        Guidance scale γ, 0 to 20: how strongly the shadow steers the object's shading; 1 is off.
    beta : float
        Shadow latent weight β in [0, 1], at the backbone's own number of steps. At another number
        each blend weighs so much more or less that all of them put in as much shadow
        (`spotlight_runtime.diffusion.blending.weight_of_steps`), but not in the release's fidelity.
    seed : int
        Of all randomness, 0 to 2⁶³ − 1. The same seed gives the same bytes on the same machine.
    steps : int or None
        Denoising steps; the backbone's own number by default.
    solver : {"ddim", "dpmpp_2m", "unipc"}
    fidelity : {"paper", "release"}
        ``paper``: blended noise at the latents' own level and shared with the start, posterior
        mean, background touched only inside the shadow's region. ``release``: what the public
        release does (noise of the step's own t, fresh each step, posterior sample, ratio over the
        whole picture).
    guidance_rescale : float
        φ in [0, 1] of Lin et al. 2023; 0 is off.
    shadow_opacity : float
        Darkness of a full shadow in the rough composite, in [0, 1].
    denoise : bool or None
        Denoise the predictions; by default where the backbone was trained on noisy renders and
        the extra is installed.
    batch_branches : bool or None
        Run both branches in one network call; by default where that pays for the backbone
        (`BackboneSpec.batch_branches`). It takes more memory.
    guidance_interval : (float, float)
        From which to which share of the steps the two branches are contrasted (Kynkäänniemi et
        al. 2024); outside it the negative one is not evaluated.
    plain_steps : int or None
        Steps of the pass without shadow; as many as the others by default.
    reuse : int
        Steps between two evaluations of the whole denoiser; in those between, only what runs at
        latent size is evaluated, on the deep features of the last whole one (Ma et al. 2024). 1 is
        off, as it is with a model that brings no graph for it.
    window : {"auto", "frame", "tight", "coarse"}
        ``auto``: a photograph larger than the backbone was trained at is diffused in a window
        around object and shadow, at the backbone's scale, and put back sharp. ``frame``: always
        all of it at its own scale, whatever time and memory that takes. ``tight``: no more than
        object, shadows and a margin, of a small photograph too. ``coarse``: the same at 5/8 of the
        backbone's scale, for one that has learned to see smaller, as the mini has.
    detail : {"auto", "renderer", "maps"}
        Whose detail the object shows. ``renderer``: the predicted pixels, as the paper does.
        ``maps``: the predicted shading on the object's own albedo and normals, sharper than any
        decoder. ``auto``: the renderer's where the whole photograph is diffused by a backbone
        whose pixels are to be believed (`BackboneSpec.light_reach`), else the maps'; a window that
        is enlarged has no other.
    skip : bool
        Leave out what the scene does not call for (`spotlight_runtime.planning.rules`). Off, every
        pass runs, as in the public release; the picture is the same.

    Raises
    ------
    InvalidInputError
        If an option is outside its domain.
    """

    gamma: float = 3.0
    beta: float = 0.05
    seed: int = 469
    steps: int | None = None
    solver: SolverName = "ddim"
    fidelity: Fidelity = "paper"
    guidance_rescale: float = 0.0
    shadow_opacity: float = 1.0
    denoise: bool | None = None
    batch_branches: bool | None = None
    guidance_interval: tuple[float, float] = (0.0, 1.0)
    plain_steps: int | None = None
    reuse: int = 1
    window: WindowMode = "auto"
    detail: Detail = "auto"
    skip: bool = True

    def __post_init__(self) -> None:
        # Numbers are kept as Python's own: numpy's are no JSON.
        for name, high in _LIMITS.items():
            value = as_float(getattr(self, name))
            if not 0.0 <= value <= high:
                raise InvalidInputError(
                    f"{name}: expected a number from 0 to {high:g}, got {getattr(self, name)!r}"
                )
            object.__setattr__(self, name, value)
        object.__setattr__(self, "seed", checked_seed(self.seed))
        for name in ("steps", "plain_steps", "reuse"):
            value = getattr(self, name)
            if value is not None or name == "reuse":
                object.__setattr__(self, name, _counted(name, value))
        given = self.guidance_interval
        interval = tuple(map(as_float, given)) if isinstance(given, Iterable) else ()
        if len(interval) != 2 or not 0.0 <= interval[0] <= interval[1] <= 1.0:
            raise InvalidInputError(
                "guidance_interval: expected two shares of the steps, 0 ≤ from ≤ to ≤ 1, got "
                f"{given!r}"
            )
        object.__setattr__(self, "guidance_interval", interval)
        if self.fidelity not in ("paper", "release"):
            raise InvalidInputError(
                f"fidelity: expected 'paper' or 'release', got {self.fidelity!r}"
            )
        if self.solver not in SOLVERS:
            raise InvalidInputError(
                f"solver: expected one of {', '.join(SOLVERS)}, got {self.solver!r}"
            )
        if self.window not in get_args(WindowMode):
            raise InvalidInputError(
                f"window: expected {', '.join(get_args(WindowMode))}, got {self.window!r}"
            )
        if self.detail not in get_args(Detail):
            raise InvalidInputError(
                f"detail: expected {', '.join(get_args(Detail))}, got {self.detail!r}"
            )

    def steps_for(self, spec: BackboneSpec) -> int:
        """Number of denoising steps with this backbone.

        Raises
        ------
        InvalidInputError
            If the backbone was trained on fewer.
        """
        return _checked_steps("steps", self.steps, spec.schedule.steps, spec)

    def batched_for(self, spec: BackboneSpec) -> bool:
        """Whether both branches are run in one call of this backbone."""
        return spec.batch_branches if self.batch_branches is None else self.batch_branches

    def weight_of_steps(self, steps: int, usual: int) -> float:
        """What β weighs in each of so many steps, where ``usual`` are the backbone's own."""
        if self.fidelity == "release":
            return self.beta
        return weight_of_steps(self.beta, usual, steps)

    def for_backbone(self, spec: BackboneSpec) -> RelightOptions:
        """The same with nothing left to this backbone to say.

        Raises
        ------
        InvalidInputError
            If the backbone was trained on fewer.
        """
        steps = self.steps_for(spec)
        plain = _checked_steps("plain_steps", self.plain_steps, steps, spec)
        batched = self.batched_for(spec)
        return replace(self, steps=steps, plain_steps=plain, batch_branches=batched)


def _counted(name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
        raise InvalidInputError(f"{name}: expected a whole number from 1, got {value!r}")
    return int(value)


def _checked_steps(name: str, wanted: int | None, usual: int, spec: BackboneSpec) -> int:
    steps, most = usual if wanted is None else wanted, spec.schedule.num_train_timesteps
    if steps > most:
        raise InvalidInputError(f"{name}: expected a whole number from 1 to {most}, got {steps}")
    return steps


class OptionChanges(TypedDict, total=False):
    """The fields of `RelightOptions` as keywords of a call; see there."""

    gamma: float
    beta: float
    seed: int
    steps: int | None
    solver: SolverName
    fidelity: Fidelity
    guidance_rescale: float
    shadow_opacity: float
    denoise: bool | None
    batch_branches: bool | None
    guidance_interval: tuple[float, float]
    plain_steps: int | None
    reuse: int
    window: WindowMode
    detail: Detail
    skip: bool
