"""Let a checkpoint's own configuration refine the backbone's specification."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from spotlight_export.errors import CheckpointError
from spotlight_spec import BackboneSpec, LatentSpec

__all__ = ["adopt_configuration"]

ADOPTED = (
    "num_train_timesteps",
    "beta_start",
    "beta_end",
    "beta_schedule",
    "prediction_type",
    "set_alpha_to_one",
    "clip_sample",
)
"""Schedule settings taken from the base model. Spacing and zero terminal SNR are not among them:
the ControlNet was trained with the specification's, whatever the base model was used with."""

SILENT = ("set_alpha_to_one", "clip_sample")
"""Settings the base model is expected to decide; adopting them needs no warning."""


def adopt_configuration(
    spec: BackboneSpec, vae: dict[str, Any], scheduler: dict[str, Any]
) -> tuple[BackboneSpec, list[str]]:
    """Specification with the checkpoint's latent space and schedule, and what deserves a warning.

    Parameters
    ----------
    spec : BackboneSpec
    vae, scheduler : dict
        The checkpoint's ``vae/config.json`` and ``scheduler/scheduler_config.json``.

    Returns
    -------
    spec : BackboneSpec
    warnings : list of str
        One line per setting that differs from the specification in a way that changes images.

    Raises
    ------
    CheckpointError
        If the schedule is one SpotLight cannot walk.
    """
    latent = LatentSpec(
        channels=vae.get("latent_channels", spec.latent.channels),
        downscale=2 ** (len(vae["block_out_channels"]) - 1)
        if "block_out_channels" in vae
        else spec.latent.downscale,
        scaling_factor=float(vae.get("scaling_factor", spec.latent.scaling_factor)),
    )
    adopted = {name: scheduler[name] for name in ADOPTED if name in scheduler}
    _check_schedule(spec, adopted)
    schedule = replace(spec.schedule, **adopted)
    warnings = [
        f"the checkpoint's {where} has {field.name} = {new}, {spec.name} expects {old}; "
        "the checkpoint's value is used"
        for where, before, after in (
            ("VAE", spec.latent, latent),
            ("scheduler", spec.schedule, schedule),
        )
        for field in fields(before)
        if (new := getattr(after, field.name)) != (old := getattr(before, field.name))
        and field.name not in SILENT
    ]
    if scheduler.get("thresholding") or scheduler.get("trained_betas"):
        warnings.append(
            "the checkpoint's scheduler sets thresholding or trained_betas, which SpotLight does "
            "not use"
        )
    return replace(spec, latent=latent, schedule=schedule), warnings


def _check_schedule(spec: BackboneSpec, adopted: dict[str, Any]) -> None:
    curve = adopted.get("beta_schedule", spec.schedule.beta_schedule)
    if curve not in ("scaled_linear", "linear"):
        raise CheckpointError(
            f"scheduler_config.json has beta_schedule {curve!r}; expected 'scaled_linear' or "
            "'linear'. Use the base model the ControlNet was trained on"
        )
    prediction = adopted.get("prediction_type", spec.schedule.prediction_type)
    if prediction not in ("v_prediction", "sample", "epsilon"):
        raise CheckpointError(
            f"scheduler_config.json has prediction_type {prediction!r}; expected 'v_prediction'"
        )
    if prediction == "epsilon" and spec.schedule.rescale_betas_zero_snr:
        raise CheckpointError(
            "scheduler_config.json has prediction_type 'epsilon', which is undefined at the zero "
            f"terminal SNR that {spec.name} was trained with; expected 'v_prediction'. Use the "
            "768-pixel Stable Diffusion 2.1 as base, not the 512-pixel one"
        )
