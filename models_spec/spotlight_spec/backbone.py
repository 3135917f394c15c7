"""What a diffusion-renderer backbone *is*, as data.

A backbone is described by what its networks were trained to receive (maps, their order, ranges and
fill value), the latent space they work in and the noise schedule. Nothing here computes: the
exporter writes a `BackboneSpec` into a model's manifest and the runtime obeys it, so a backbone
with other maps, another order or another schedule is another value, never another code path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["BackboneSpec", "LatentSpec", "MapSpec", "ScheduleSpec", "ShadingSpec"]

MapName = Literal[
    "depth",
    "normal",
    "albedo",
    "shading",
    "mask",
    "roughness",
    "metallic",
    "irradiance",
    "masked_image",
]
ImageEncoding = Literal["gamma22", "srgb", "linear"]
MOST_REACH: Final = 256.0
"""Pixels: beyond a picture's middle to its border, light is the same everywhere."""


@dataclass(frozen=True, slots=True)
class MapSpec:
    """One conditioning map, as the network expects it.

    Attributes
    ----------
    name : str
        Which intrinsic map. ZeroComp's ``diffuse`` is called ``albedo`` here.
    channels : int
        Channels it occupies in the conditioning array.
    minimum, maximum : float
        Range the values are clipped to (``normal``: camera space mapped to [0, 1]; ``depth``:
        metres; ``mask``: −1 where shading is masked, 1 where it is known).
    fill : float or None
        Value inside the masked region; None where a map is never masked.
    """

    name: MapName
    channels: int
    minimum: float
    maximum: float
    fill: float | None = None


@dataclass(frozen=True, slots=True)
class LatentSpec:
    """The VAE's latent space, and where in it sampling starts.

    Where ᾱ = 0 the initial latents hold nothing of a picture, and what they are should not matter.
    A small network takes some of them for light all the same: it is best started where it errs
    least, near one place, and not at any draw of unit noise.

    Attributes
    ----------
    channels : int
    downscale : int
        Pixels of a side to a latent.
    scaling_factor : float
        ``z = E(image) · scaling_factor``.
    start_mean : tuple of float
        Mean of the initial latents, one number a channel; empty: 0.
    start_deviation : float
        Their standard deviation, and that of the noise of blends, in [0, 1]; 1: unit noise, as
        diffusion has it.
    """

    channels: int = 4
    downscale: int = 8
    scaling_factor: float = 0.18215
    start_mean: tuple[float, ...] = ()
    start_deviation: float = 1.0

    def __post_init__(self) -> None:
        if len(self.start_mean) not in (0, self.channels):
            raise ValueError(
                f"latent space: expected a start_mean of {self.channels} numbers or of none, got "
                f"{len(self.start_mean)}"
            )
        if not 0.0 <= self.start_deviation <= 1.0:
            raise ValueError(
                "latent space: expected a start_deviation from 0 to 1, got "
                f"{self.start_deviation!r}"
            )


@dataclass(frozen=True, slots=True)
class ScheduleSpec:
    """Training noise schedule and how inference walks it.

    Attributes
    ----------
    num_train_timesteps : int
        Length of the training schedule.
    beta_start, beta_end : float
        Ends of the β curve.
    beta_schedule : {"scaled_linear", "linear"}
        ``scaled_linear`` is linear in √β (latent diffusion).
    prediction_type : {"v_prediction", "epsilon", "sample"}
        What the network's output means; ``epsilon`` is undefined where ᾱ = 0.
    timestep_spacing : {"trailing"}
        Starts at the last train step, as zero terminal SNR requires.
    rescale_betas_zero_snr : bool
        Shift and scale √ᾱ so that ᾱ at the last train step is exactly 0 (Lin et al. 2023).
    set_alpha_to_one : bool
        Whether the step after the last one has ᾱ = 1, else ᾱ of the first train step.
    clip_sample : bool
        Whether predicted x0 is clipped to [−1, 1].
    steps : int
        Number of inference steps the backbone is used with.
    """

    num_train_timesteps: int = 1000
    beta_start: float = 0.00085
    beta_end: float = 0.012
    beta_schedule: Literal["scaled_linear", "linear"] = "scaled_linear"
    prediction_type: Literal["v_prediction", "epsilon", "sample"] = "v_prediction"
    timestep_spacing: Literal["trailing"] = "trailing"
    rescale_betas_zero_snr: bool = True
    set_alpha_to_one: bool = False
    clip_sample: bool = False
    steps: int = 20


@dataclass(frozen=True, slots=True)
class ShadingSpec:
    """How the shading map is made: ``clip(encoded_background / (albedo + epsilon))``.

    ``known`` says where the network is told the shading: everywhere but object and shadow
    (``outside``, relighting an inserted object) or only there (``inside``, the inverted-mask
    checkpoint that relights the whole image around them). ``usual_light``: median of linear
    background ÷ albedo that an albedo of unknown scale is brought to; 0: it is taken as given, by
    backbones trained on estimates.
    """

    background_encoding: ImageEncoding = "gamma22"
    epsilon: float = 1e-6
    known: Literal["outside", "inside"] = "outside"
    usual_light: float = 0.0


@dataclass(frozen=True, slots=True)
class BackboneSpec:
    """Everything the runtime must know about a backbone.

    Attributes
    ----------
    name : str
        Identifier on the command line and in model folders.
    title : str
        One line for people.
    maps : tuple of MapSpec
        Conditioning maps in channel order; the order is a property of the checkpoint.
    latent : LatentSpec
    schedule : ScheduleSpec
    shading : ShadingSpec
    image_encoding : {"gamma22", "srgb", "linear"}
        Transfer curve of the images the VAE was trained on, before scaling to [−1, 1].
    conditioning_layout : {"controlnet", "latent_concat"}
        How the networks take the conditioning: ZeroComp's ControlNet, or maps encoded to latent
        size and concatenated to the noisy latents as RGB↔X does.
    size : int
        Side in pixels of the square the backbone was trained at.
    noisy_renders : bool
        Trained on noisy path-traced images, so its output is meant to be denoised.
    light_reach : float
        Pixels over which the light it finds on an object is smooth: a small renderer knows how
        an object is lit before it knows how its pixels look. 0: its pixels are to be believed.
    batch_branches : bool
        Whether both branches in one call are quicker than one after the other: they are where a
        call costs more than the arithmetic in it, as in a small network on few cores.
    """

    name: str
    title: str
    maps: tuple[MapSpec, ...]
    latent: LatentSpec = LatentSpec()
    schedule: ScheduleSpec = ScheduleSpec()
    shading: ShadingSpec = ShadingSpec()
    image_encoding: ImageEncoding = "gamma22"
    conditioning_layout: Literal["controlnet", "latent_concat"] = "controlnet"
    size: int = 512
    noisy_renders: bool = False
    light_reach: float = 0.0
    batch_branches: bool = False

    def __post_init__(self) -> None:
        names = [entry.name for entry in self.maps]
        if len(set(names)) != len(names):
            raise ValueError(f"backbone {self.name!r} names a conditioning map twice: {names}")
        if not 0.0 <= self.light_reach <= MOST_REACH:
            raise ValueError(
                f"backbone {self.name!r}: expected a light_reach from 0 to {MOST_REACH:g} pixels, "
                f"got {self.light_reach!r}"
            )

    @property
    def channels(self) -> dict[str, slice]:
        """Where each map is in the conditioning array."""
        found: dict[str, slice] = {}
        start = 0
        for entry in self.maps:
            found[entry.name] = slice(start, start + entry.channels)
            start += entry.channels
        return found

    @property
    def own_sizes(self) -> dict[str, int]:
        """Dynamic dimensions of its graphs for one branch of the square it was trained at."""
        latent = self.size // self.latent.downscale
        sides = {"latent_height": latent, "latent_width": latent}
        return {"batch": 1, "height": self.size, "width": self.size} | sides

    @property
    def conditioning_channels(self) -> int:
        """Channels of the conditioning array."""
        return sum(entry.channels for entry in self.maps)
