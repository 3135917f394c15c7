"""What a scene calls for: from facts about it and options to a plan.

The exact rules leave out what could not change the picture:

* where γ = 1, no object is in sight, or both branches' shadows are the same, guidance multiplies by
  nothing: there is no negative branch;
* where β = 0, or a branch's shadow covers no latent, blending adds nothing: that branch's rough
  composite is not encoded;
* where a light throws no shadow into the picture and nothing contrasts it, its pass *is* the pass
  without shadow; and this is run once for all lights, and once a scene and seed.

The others trade accuracy for time, and are the options' to ask for: fewer steps, guidance in some
of them, fewer steps without shadow, deep features of an earlier step, a tight window or a coarse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from spotlight_runtime.planning.costs import Costs
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.planning.plan import Effect, GuidedPass, PlainPass, Plan

__all__ = ["Facts", "LightFacts", "make_plan", "part_of"]


@dataclass(frozen=True, slots=True)
class LightFacts:
    """What the rules need to know of a light.

    Attributes
    ----------
    shadow : bool
        Whether its shadow is in the picture.
    blendable : tuple of bool
        By branch, positive first: whether its shadow covers a latent.
    contrast : bool
        Whether the two branches' shadows differ.
    """

    shadow: bool
    blendable: tuple[bool, bool]
    contrast: bool


@dataclass(frozen=True, slots=True)
class Facts:
    """What the rules need to know of a scene and its lights.

    Attributes
    ----------
    lights : tuple of LightFacts
    object_seen : bool
        Whether the object covers any of the latents.
    latents : int
        Height × width at latent size.
    pixels : int
        Of the photograph.
    native : bool
        Whether the whole photograph is diffused, at its own scale.
    window : str
        What is diffused, in words.
    softness : str
        ``on …`` or ``off: why``: whether soft shadows were cast.
    denoised : str
        ``on``, or why not.
    own_steps : int
        The backbone's usual number of steps.
    reusable : bool
        Whether the model has a graph that predicts from an earlier step's deep features.
    remembered : bool
        Whether the picture without shadow is known from before.
    prepared_seconds : float
        How long casting shadows and choosing the window took.
    """

    lights: tuple[LightFacts, ...]
    object_seen: bool
    latents: int
    pixels: int
    native: bool
    window: str
    softness: str
    denoised: str
    own_steps: int
    reusable: bool = False
    remembered: bool = False
    prepared_seconds: float = 0.0


def make_plan(
    facts: Facts, options: RelightOptions, costs: Costs | None = None, name: str | None = None
) -> Plan:
    """Decide what is run.

    Parameters
    ----------
    facts : Facts
    options : RelightOptions
        With nothing left to the backbone (`RelightOptions.for_backbone`).
    costs : Costs, optional
        To predict seconds with.
    name : str, optional
        What the options are called; by default ``exact`` or ``custom``.

    Returns
    -------
    Plan
    """
    passes = tuple(_guided_pass(facts, light, options) for light in facts.lights)
    plain = _plain_pass(facts, passes[0], options)
    effects = _effects(facts, passes, plain, options, costs)
    usual = "exact" if all(effect.exact for effect in effects) else "custom"
    return Plan(passes, plain, effects, bool(options.batch_branches), name or usual)


def part_of(
    plan: Plan, number: int, facts: Facts, options: RelightOptions, costs: Costs | None = None
) -> Plan:
    """What of a plan is for one of its lights; what all share is for the first of them.

    Parameters
    ----------
    plan : Plan
        As `make_plan` makes it of the other arguments.
    number : int
        Which light.
    facts, options, costs
        As `make_plan` takes them.
    """
    part = plan.only(number, first=number == 0)
    shared = facts.prepared_seconds if number == 0 else 0.0
    alone = replace(facts, lights=(facts.lights[number],), prepared_seconds=shared)
    return replace(part, effects=_effects(alone, part.passes, part.plain, options, costs))


def _effects(
    facts: Facts,
    passes: tuple[GuidedPass, ...],
    plain: PlainPass,
    options: RelightOptions,
    costs: Costs | None,
) -> tuple[Effect, ...]:
    effects = (
        _relight_effect(facts, passes, options),
        _guidance_effect(facts, passes, options),
        _blending_effect(facts, passes, options),
        _plain_effect(facts, plain, options),
        _reuse_effect(facts, passes, plain, options),
        Effect("soft shadows", *_switch(facts.softness), seconds=facts.prepared_seconds),
        Effect("window", not facts.native, facts.window, exact=options.window in ("auto", "frame")),
        Effect("denoiser", *_switch(facts.denoised)),
        Effect("composite", True, "puts light and shadow into the photograph"),
    )
    return effects if costs is None else _priced(effects, passes, plain, facts, costs)


def _guided_pass(facts: Facts, light: LightFacts, options: RelightOptions) -> GuidedPass:
    steps = options.steps
    assert steps is not None
    first, last = (round(share * steps) for share in options.guidance_interval)
    blended = options.beta > 0.0 and steps > 1
    reuse = _reuse(facts, options)
    if not options.skip:
        return GuidedPass(steps, (first, last), (True, True), reuse)
    encoded = tuple(blended and each for each in light.blendable)
    # The release draws each branch's latents anew, so equal shadows part once they are blended.
    differ = light.contrast or (options.fidelity == "release" and any(encoded))
    if options.gamma == 1.0 or not (facts.object_seen and differ and first < last):
        return GuidedPass(steps, (0, 0), encoded[:1], reuse)
    return GuidedPass(steps, (first, last), encoded, reuse)


def _reuse(facts: Facts, options: RelightOptions) -> int:
    return options.reuse if facts.reusable else 1


def _plain_pass(facts: Facts, first: GuidedPass, options: RelightOptions) -> PlainPass:
    steps = options.plain_steps
    assert steps is not None
    reuse = _reuse(facts, options)
    if not options.skip:
        return PlainPass(steps, "run", reuse)
    if facts.remembered:
        return PlainPass(steps, "remembered", reuse)
    unguided = first.branches == 1 and not first.blends and not facts.lights[0].shadow
    return PlainPass(steps, "relight" if unguided and steps == first.steps else "run", reuse)


def _relight_effect(
    facts: Facts, passes: tuple[GuidedPass, ...], options: RelightOptions
) -> Effect:
    steps = f"{options.steps} steps of {options.solver}"
    usual = options.steps == facts.own_steps and options.solver == "ddim"
    reason = steps if usual else f"{steps}, where the backbone's own are {facts.own_steps} of ddim"
    if len(passes) > 1:
        reason = f"{len(passes)} lights; {reason}"
    shallow = sum(p.shallow[0] for p in passes)
    return Effect("relight", True, reason, usual, sum(p.steps for p in passes), shallow=shallow)


def _guidance_effect(
    facts: Facts, passes: tuple[GuidedPass, ...], options: RelightOptions
) -> Effect:
    evaluations = sum(p.contrasts for p in passes)
    whole = options.guidance_interval == (0.0, 1.0)
    if evaluations:
        first, last = options.guidance_interval
        some = "" if whole else f", from {first:.0%} to {last:.0%} of the steps"
        reason, shallow = f"γ = {options.gamma:g}{some}", sum(p.shallow[1] for p in passes)
        return Effect("guidance", True, reason, whole, evaluations, shallow=shallow)
    if options.gamma == 1.0:
        reason = "γ = 1 adds nothing"
    elif not facts.object_seen:
        reason = "there is no object to guide"
    elif not any(light.contrast for light in facts.lights):
        reason = "both branches have the same shadow"
    else:
        return Effect("guidance", False, "in none of the steps", exact=False)
    return Effect("guidance", False, reason)


def _blending_effect(
    facts: Facts, passes: tuple[GuidedPass, ...], options: RelightOptions
) -> Effect:
    encodes = sum(sum(p.encoded) for p in passes)
    if encodes:
        assert options.steps is not None
        weight = options.weight_of_steps(options.steps, facts.own_steps)
        each = "" if weight == options.beta else f", {weight:.2g} a step"
        return Effect("shadow blending", True, f"β = {options.beta:g}{each}; {encodes} encoded")
    if options.beta == 0.0:
        return Effect("shadow blending", False, "β = 0 adds nothing")
    if options.steps == 1:
        return Effect("shadow blending", False, "the last step is not blended")
    return Effect("shadow blending", False, "no shadow covers a latent")


def _plain_effect(facts: Facts, plain: PlainPass, options: RelightOptions) -> Effect:
    name = "pass without shadow"
    if plain.source == "remembered":
        return Effect(name, False, "known from an earlier relight of this scene and seed")
    if plain.source == "relight":
        return Effect(name, False, "no shadow is in the picture: the relight itself is one")
    shared = f", once for {len(facts.lights)} lights" if len(facts.lights) > 1 else ""
    reason = f"what the shadow is measured against{shared}"
    same = plain.steps == options.steps
    fewer = "" if same else f", in {plain.steps} steps"
    return Effect(name, True, reason + fewer, same, plain.evaluations, shallow=plain.shallow)


def _reuse_effect(
    facts: Facts, passes: tuple[GuidedPass, ...], plain: PlainPass, options: RelightOptions
) -> Effect:
    name = "feature reuse"
    if options.reuse == 1:
        return Effect(name, False, "not wanted")
    if not facts.reusable:
        return Effect(name, False, "the model has no graph for it")
    shallow = plain.shallow + sum(sum(p.shallow) for p in passes)
    if not shallow:
        return Effect(name, False, "there is no step to reuse them in")
    said = f"the whole denoiser in one of {options.reuse} steps; {shallow} evaluations are shallow"
    return Effect(name, True, said, exact=False)


def _switch(said: str) -> tuple[bool, str]:
    """``on: why`` or ``off: why`` as a switch and a reason."""
    state, _, reason = said.partition(": ")
    return state == "on", reason


def _priced(
    effects: tuple[Effect, ...],
    passes: tuple[GuidedPass, ...],
    plain: PlainPass,
    facts: Facts,
    costs: Costs,
) -> tuple[Effect, ...]:
    """The effects with predicted seconds."""
    size = facts.latents
    condition = costs.condition.at(size)
    decode, encode = costs.decode.at(size), costs.encode.at(size)
    negatives = sum(p.branches - 1 for p in passes)
    ran = plain.source == "run"
    run = {"relight": len(passes), "pass without shadow": int(ran)}
    extra = {
        "relight": len(passes) * (condition + decode),
        "guidance": negatives * condition,
        "shadow blending": encode * sum(sum(p.encoded) for p in passes),
        "pass without shadow": (condition + decode) * ran,
        "composite": len(passes) * costs.composite(facts.pixels, facts.native),
    }
    return tuple(
        effect
        if effect.seconds is not None
        else replace(
            effect,
            seconds=costs.evaluations(
                size,
                effect.evaluations - effect.shallow,
                effect.shallow,
                run.get(effect.name, 0),
            )
            + extra.get(effect.name, 0.0),
        )
        for effect in effects
    )
