"""A plan: which passes a relight makes, which effects it simulates, and what each is for."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any, Final, Literal

__all__ = ["Effect", "GuidedPass", "PlainPass", "Plan"]

TOGETHER: Final = 2
"""Lights in one call, at most: from four branches on, more of them make a call no cheaper."""


@dataclass(frozen=True, slots=True)
class GuidedPass:
    """The loop of one light.

    Attributes
    ----------
    steps : int
    contrasted : tuple of int
        First step at which the negative branch is evaluated, too, and the first after it at which
        it no longer is; the same number twice where there is no negative branch.
    encoded : tuple of bool
        By branch, positive first: whether its rough composite is encoded and blended in.
    reuse : int
        Steps between two evaluations of the whole denoiser; 1: there are no others.
    """

    steps: int
    contrasted: tuple[int, int]
    encoded: tuple[bool, ...]
    reuse: int = 1

    @property
    def branches(self) -> int:
        """One, or two with guidance."""
        return len(self.encoded)

    @property
    def contrasts(self) -> int:
        """Evaluations of the negative branch."""
        return self.contrasted[1] - self.contrasted[0]

    @property
    def evaluations(self) -> int:
        """Evaluations of both branches."""
        return self.steps + self.contrasts

    @property
    def blends(self) -> bool:
        """Whether anything is blended into the latents."""
        return any(self.encoded)

    def branches_at(self, step: int) -> int:
        """How many branches the network is asked for at a step."""
        return 2 if self.contrasted[0] <= step < self.contrasted[1] else 1

    def shallow_at(self, step: int) -> bool:
        """Whether a step goes without the deep part: its branches kept theirs from before."""
        begins = self.contrasts > 0 and step == self.contrasted[0]
        return step % self.reuse > 0 and not begins

    @property
    def shallow(self) -> tuple[int, int]:
        """Evaluations without the deep part, of the positive branch and of the negative."""
        steps = [self.branches_at(step) for step in range(self.steps) if self.shallow_at(step)]
        return len(steps), steps.count(2)


@dataclass(frozen=True, slots=True)
class PlainPass:
    """The pass without shadow, shared by all lights.

    Attributes
    ----------
    steps : int
    source : {"run", "remembered", "relight"}
        Whether it is run, was run before for the same scene and seed, or is the relight pass
        itself.
    reuse : int
        As `GuidedPass` has it.
    """

    steps: int
    source: Literal["run", "remembered", "relight"]
    reuse: int = 1

    @property
    def evaluations(self) -> int:
        """Evaluations it takes."""
        return self.steps if self.source == "run" else 0

    @property
    def shallow(self) -> int:
        """How many of them go without the deep part."""
        return self.evaluations - -(-self.evaluations // self.reuse)


@dataclass(frozen=True, slots=True)
class Effect:
    """Something a relight may simulate.

    Attributes
    ----------
    name : str
    on : bool
    reason : str
        Why, or why not.
    exact : bool
        Whether the picture is the same, in real arithmetic, as with everything simulated.
    evaluations : int
        Denoiser evaluations it takes.
    shallow : int
        How many of them go without the deep part.
    seconds : float or None
        Predicted; None where the machine has not been measured.
    """

    name: str
    on: bool
    reason: str
    exact: bool = True
    evaluations: int = 0
    seconds: float | None = None
    shallow: int = 0


@dataclass(frozen=True, slots=True)
class Plan:
    """What a relight will do.

    Attributes
    ----------
    passes : tuple of GuidedPass
        One a light.
    plain : PlainPass
    effects : tuple of Effect
    batched : bool
        Whether both branches go through the network in one call, and two lights' likewise.
    name : str
        ``exact``, ``balanced``, ``draft``, or ``custom``.
    accompanied : bool
        Whether its light went through the network with the one before, whose plan has the calls.
    """

    passes: tuple[GuidedPass, ...]
    plain: PlainPass
    effects: tuple[Effect, ...]
    batched: bool = False
    name: str = "exact"
    accompanied: bool = False

    @property
    def evaluations(self) -> int:
        """Denoiser evaluations, one a branch and step, whole or shallow."""
        return self.plain.evaluations + sum(p.evaluations for p in self.passes)

    @property
    def shallow(self) -> int:
        """How many of them go without the deep part."""
        return self.plain.shallow + sum(sum(p.shallow) for p in self.passes)

    @property
    def passes_run(self) -> int:
        """How many passes are evaluated, that without shadow among them."""
        return len(self.passes) + (self.plain.source == "run")

    @property
    def together(self) -> list[range]:
        """Which lights go through the network together, in order: neighbours with like loops."""
        if not self.batched:
            return [range(n, n + 1) for n in range(len(self.passes))]
        found, start = [], 0
        for _, alike in groupby(self.passes, key=lambda p: replace(p, encoded=(p.branches == 2,))):
            stop = start + len(list(alike))
            found += [range(n, min(n + TOGETHER, stop)) for n in range(start, stop, TOGETHER)]
            start = stop
        return found

    @property
    def seconds(self) -> float | None:
        """Predicted time of it all; None where the machine has not been measured."""
        known = [effect.seconds for effect in self.effects if effect.seconds is not None]
        return sum(known) if len(known) == len(self.effects) else None

    def calls(self) -> dict[str, int]:
        """How often each graph will be run; ``denoiser`` stands for a controlnet and its unet."""
        count: Counter[str] = Counter()
        count["denoiser"] = self.plain.evaluations - self.plain.shallow
        count["denoiser_shallow"] = self.plain.shallow
        for each in self.passes:
            count["vae_encoder"] += sum(each.encoded)
            count["condition_encoder"] += each.branches
            count["vae_decoder"] += 1
        for lights in [] if self.accompanied else self.together:
            each = self.passes[lights[0]]
            positive, negative = each.shallow
            whole = each.steps - positive, each.contrasts - negative
            count["denoiser"] += whole[0] + (0 if self.batched else whole[1])
            count["denoiser_shallow"] += positive + (0 if self.batched else negative)
        if self.plain.source == "run":
            count["condition_encoder"] += 1
            count["vae_decoder"] += 1
        return {graph: number for graph, number in count.items() if number}

    def only(self, number: int, *, first: bool) -> Plan:
        """The same for one of its lights; what lights share belongs to the first of them.

        Its effects are those of all lights still (`spotlight_runtime.planning.rules.part_of`).
        """
        plain = self.plain
        if not first and plain.source == "run":
            plain = replace(plain, source="remembered")
        accompanied = any(number in lights[1:] for lights in self.together)
        return replace(self, passes=(self.passes[number],), plain=plain, accompanied=accompanied)

    def report(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "name": self.name,
            "evaluations": self.evaluations,
            "calls": self.calls(),
            "predicted_seconds": None if self.seconds is None else round(self.seconds, 4),
            "effects": [asdict(effect) for effect in self.effects],
        }
