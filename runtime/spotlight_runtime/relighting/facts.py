"""What a plan needs to know of a scene and its lights, read off what was prepared."""

from __future__ import annotations

from collections.abc import Sequence

from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.planning.rules import Facts
from spotlight_runtime.relighting.guides import Guide
from spotlight_runtime.relighting.preparation import Prepared, guidance_mask, light_facts
from spotlight_spec import BackboneSpec

__all__ = ["scene_facts", "softness"]


def scene_facts(
    spec: BackboneSpec,
    prepared: Prepared,
    *,
    soft: str,
    denoised: str,
    reusable: bool,
) -> Facts:
    """Facts of a prepared relight whose picture without shadow is not known.

    Parameters
    ----------
    spec : BackboneSpec
    prepared : Prepared
    soft : str
        As `softness` says it.
    denoised : str
        ``on``, or why not.
    reusable : bool
        Whether the model predicts from an earlier step's deep features, too.

    Returns
    -------
    Facts
    """
    view, window = prepared.view, prepared.window
    return Facts(
        lights=tuple(light_facts(spec, view, shadows) for shadows in prepared.shadows),
        object_seen=bool(guidance_mask(spec, view).any()),
        latents=prepared.latents(spec),
        pixels=window.frame[0] * window.frame[1],
        native=window.native,
        window=_said(prepared),
        softness=soft,
        denoised=denoised,
        own_steps=spec.schedule.steps,
        reusable=reusable,
    )


def softness(guide: Guide | Sequence[Guide]) -> str:
    """``on: …`` or ``off: why``: whether lights cast soft shadows."""
    guides = tuple(guide) if isinstance(guide, Sequence) else (guide,)
    lights = [each for each in guides if isinstance(each, Light)]
    if not lights:
        return "off: the shadows came ready"
    soft = sum(light.radius > 0.0 for light in lights)
    if not soft:
        return "off: a light without size needs one ray a pixel"
    return f"on: {soft} of {len(guides)} lights have a size"


def _said(prepared: Prepared) -> str:
    window = prepared.window
    height, width = window.size
    if window.native:
        return f"the whole photograph, {width}×{height}"
    return (
        f"{window.width}×{window.height} of {window.frame[1]}×{window.frame[0]} pixels, "
        f"diffused at {width}×{height}"
    )
