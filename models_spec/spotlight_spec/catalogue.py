"""The backbones SpotLight knows by name.

Sources: ZeroComp's published checkpoints (Zhang et al. 2025) with Stable Diffusion 2.1's latent
space and schedule. The order of maps differs between checkpoints and is part of each entry; an
exporter may replace ``latent`` and ``schedule`` by what the checkpoint's own configuration says.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from spotlight_spec.backbone import BackboneSpec, LatentSpec, MapSpec, ScheduleSpec, ShadingSpec

__all__ = ["BACKBONES"]

DEPTH = MapSpec("depth", 1, 0.0, 20.0)
NORMAL = MapSpec("normal", 3, 0.0, 1.0)
ALBEDO = MapSpec("albedo", 3, 0.0, 1.0)
SHADING = MapSpec("shading", 3, 1e-5, 1e3, fill=-1.0)
MASK = MapSpec("mask", 1, -1.0, 1.0, fill=-1.0)
ROUGHNESS = MapSpec("roughness", 1, 0.0, 1.0)
METALLIC = MapSpec("metallic", 1, 0.0, 1.0)

_OPENROOMS = BackboneSpec(
    name="zerocomp-openrooms",
    title="ZeroComp, OpenRooms 7 days: depth, normals, albedo, shading",
    maps=(DEPTH, NORMAL, ALBEDO, SHADING, MASK),
    noisy_renders=True,
)

BACKBONES: Final[dict[str, BackboneSpec]] = {
    spec.name: spec
    for spec in (
        _OPENROOMS,
        replace(
            _OPENROOMS,
            name="zerocomp-openrooms-wo-depth",
            title="ZeroComp, OpenRooms 2 days: normals, albedo, shading",
            maps=(NORMAL, ALBEDO, SHADING, MASK),
        ),
        replace(
            _OPENROOMS,
            name="zerocomp-interiorverse",
            title="ZeroComp, InteriorVerse: adds roughness and metallic, so metals are metals",
            maps=(DEPTH, NORMAL, ALBEDO, SHADING, MASK, ROUGHNESS, METALLIC),
        ),
        replace(
            _OPENROOMS,
            name="zerocomp-inverted",
            title="ZeroComp, inverted masks: relights the image around a known object and shadow",
            shading=ShadingSpec(known="inside"),
        ),
        BackboneSpec(
            name="mini",
            title="SpotLight mini: the embedded renderer, 256 px",
            maps=(DEPTH, NORMAL, ALBEDO, SHADING, MASK, ROUGHNESS, METALLIC),
            latent=LatentSpec(channels=16, downscale=8, scaling_factor=1.0),
            schedule=ScheduleSpec(set_alpha_to_one=True),
            shading=ShadingSpec(usual_light=1.15),
            conditioning_layout="latent_concat",
            size=256,
            light_reach=8.0,
            batch_branches=True,
        ),
    )
}
"""Backbone specs by name."""
