"""Graph contracts: names, shapes, dtypes and ranges of the exported networks.

Whatever the backbone, inference needs the same four computations; only what happens inside differs:

``vae_encoder``
    image → mean and standard deviation of the latent posterior.
``condition_encoder``
    conditioning maps → what the denoiser needs of them. Run once per branch, not once per step:
    ControlNet's conditioning embedding, or RGB↔X's encoded maps.
``denoiser``
    noisy latents, timestep, encoded condition → prediction. ControlNet and UNet in one graph.
``vae_decoder``
    latents → image.

A model may bring ``denoiser_shallow``, too: what of the denoiser runs at latent size. Its
``denoiser`` then also returns ``deep``, what came up from below, and with that of an earlier step
the shallow graph predicts alone.

A model may bring ``intrinsics``: photograph → albedo, normals and depth, for
pictures that come without maps.

A ControlNet backbone can also be exported ``split``: the ``denoiser`` is then two graphs,
``controlnet`` (→ residuals) and ``unet`` (residuals →), for machines that cannot hold both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from spotlight_spec.backbone import BackboneSpec

__all__ = [
    "GraphContract",
    "GraphLayout",
    "TensorSpec",
    "graph_contracts",
    "intrinsics_contract",
]

GraphLayout = Literal["fused", "split"]
GraphName = Literal[
    "vae_encoder",
    "vae_decoder",
    "condition_encoder",
    "denoiser",
    "denoiser_shallow",
    "controlnet",
    "unet",
    "intrinsics",
]


@dataclass(frozen=True, slots=True)
class TensorSpec:
    """One input or output of a graph.

    Attributes
    ----------
    name : str
        Name in the ONNX graph.
    dtype : {"float32", "int64"}
        Element type; half precision is a storage matter inside the file, never at its border.
    shape : tuple of int or str
        A number is fixed, a name is dynamic. ``height``/``width`` are image pixels,
        ``latent_height``/``latent_width`` the same divided by the latent downscale.
    meaning : str
        Range and content, for people.
    """

    name: str
    dtype: Literal["float32", "int64"]
    shape: tuple[int | str, ...]
    meaning: str


@dataclass(frozen=True, slots=True)
class GraphContract:
    """What a graph takes and returns; ``residuals`` counts the ControlNet tensors it passes on."""

    name: GraphName
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]

    @property
    def file_name(self) -> str:
        """File the graph is stored under in a model folder."""
        return f"{self.name}.onnx"


def graph_contracts(
    spec: BackboneSpec,
    *,
    condition_channels: int,
    residual_channels: tuple[int, ...] = (),
    deep_channels: int = 0,
) -> tuple[GraphContract, ...]:
    """Contracts of all graphs of a backbone.

    Parameters
    ----------
    spec : BackboneSpec
        The backbone.
    condition_channels : int
        Channels of the encoded condition, a property of the checkpoint's architecture.
    residual_channels : tuple of int
        Channels of each ControlNet residual, in order, the mid block's last. Empty for the
        ``fused`` layout; given for the ``split`` one.
    deep_channels : int
        Channels of what comes up from below latent size in a ``fused`` denoiser; 0 where the model
        brings no ``denoiser_shallow``.

    Returns
    -------
    tuple of GraphContract
        In the order they are first needed.
    """
    image = ("batch", 3, "height", "width")
    latent = ("batch", spec.latent.channels, "latent_height", "latent_width")
    condition = TensorSpec(
        "condition",
        "float32",
        ("batch", condition_channels, "latent_height", "latent_width"),
        "encoded conditioning maps",
    )
    noisy = (
        TensorSpec("latents", "float32", latent, "noisy latents, already scaled"),
        TensorSpec("timestep", "int64", (1,), "train timestep, shared by the batch"),
    )
    prediction = TensorSpec(
        "prediction", "float32", latent, f"network output, {spec.schedule.prediction_type}"
    )
    residuals = tuple(
        TensorSpec(
            f"residual_{i}",
            "float32",
            ("batch", channels, f"residual_height_{i}", f"residual_width_{i}"),
            "ControlNet residual, mid block last",
        )
        for i, channels in enumerate(residual_channels)
    )
    denoisers: tuple[GraphContract, ...]
    if residuals:
        denoisers = (
            GraphContract("controlnet", (*noisy, condition), residuals),
            GraphContract("unet", (*noisy, *residuals), (prediction,)),
        )
    elif deep_channels:
        deep = TensorSpec(
            "deep",
            "float32",
            ("batch", deep_channels, "latent_height", "latent_width"),
            "features from below latent size, brought up to it",
        )
        denoisers = (
            GraphContract("denoiser", (*noisy, condition), (prediction, deep)),
            GraphContract("denoiser_shallow", (*noisy, condition, deep), (prediction,)),
        )
    else:
        denoisers = (GraphContract("denoiser", (*noisy, condition), (prediction,)),)
    return (
        GraphContract(
            "vae_encoder",
            (TensorSpec("image", "float32", image, "encoded image in [-1, 1]"),),
            (
                TensorSpec("latent_mean", "float32", latent, "posterior mean, unscaled"),
                TensorSpec("latent_std", "float32", latent, "posterior deviation, unscaled"),
            ),
        ),
        GraphContract(
            "condition_encoder",
            (
                TensorSpec(
                    "conditioning",
                    "float32",
                    ("batch", spec.conditioning_channels, "height", "width"),
                    "maps in the spec's order and ranges",
                ),
            ),
            (condition,),
        ),
        *denoisers,
        GraphContract(
            "vae_decoder",
            (TensorSpec("latents", "float32", latent, "latents divided by the scaling factor"),),
            (TensorSpec("image", "float32", image, "encoded image, nominally in [-1, 1]"),),
        ),
    )


def intrinsics_contract() -> GraphContract:
    """Contract of an estimator of intrinsic maps; image sides are multiples of 32."""
    return GraphContract(
        "intrinsics",
        (
            TensorSpec(
                "image",
                "float32",
                ("batch", 3, "height", "width"),
                "photograph, sRGB or gamma-2.2 encoded, in [0, 1]",
            ),
        ),
        (
            TensorSpec(
                "maps",
                "float32",
                ("batch", 7, "height", "width"),
                "albedo in [0, 1]; unit normal, camera space; depth > 0 up to scale",
            ),
        ),
    )
