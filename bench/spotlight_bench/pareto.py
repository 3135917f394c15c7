"""What savings cost: pictures of every candidate, scored against the truth and the exact plan.

`sweep` is a generator that yields after each picture's direction of each scene; close it to stop,
and run it again on the same `ResultStore` to go on. Here networks remember what they were asked, so
candidates share what they have in common and no bit of a picture changes; the seconds of a result
are those its plan predicts. Times are measured apart, with nothing remembered
(`spotlight_bench.pareto_timing`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from skimage.metrics import peak_signal_noise_ratio

from spotlight_bench import following
from spotlight_bench.backbone import Backbone
from spotlight_bench.dataset import AZIMUTHS, DOMINANT, Direction, TestScene, load_scene
from spotlight_bench.evaluate import LEVELS, Done, Perceptual
from spotlight_bench.metrics import BEST_PSNR, isolated, regions
from spotlight_bench.pareto_grid import Candidate
from spotlight_bench.results import Result, ResultStore
from spotlight_runtime import GuidingShadow, Relighter, RelightOptions
from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.planning.plan import Plan

__all__ = ["REGIONS", "directions_of", "guide_of", "psnr", "relighters", "sweep"]

REGIONS: Final = ("foreground", "background")
APART: Final = 3
"""Azimuths from one scene's first to the next one's: prime to eight, so all have their turn."""


def directions_of(index: int, azimuths: int) -> tuple[str, ...]:
    """The lights of a scene: the dominant one and some azimuths, spread evenly, turned by scene.

    Parameters
    ----------
    index : int
        Of the scene.
    azimuths : int
        How many, 0 to 8.
    """
    turned = [(APART * index + len(AZIMUTHS) * k // azimuths) % 8 for k in range(azimuths)]
    return (DOMINANT, *(AZIMUTHS[number] for number in sorted(turned)))


def relighters(backbones: Mapping[str, Backbone]) -> dict[str, Relighter]:
    """The runtime on each model, its networks remembering, itself nothing; it can tell times."""
    found = {}
    for name, each in backbones.items():
        costs = Relighter(each.spec, each.networks, remember=0).calibrated()
        found[name] = Relighter(each.spec, each.remembering, model=each.facts, remember=0)
        found[name].costs = costs
    return found


def guide_of(direction: Direction) -> GuidingShadow:
    """The shadows that guide a relight."""
    return GuidingShadow(direction.shadow, direction.opposite)


def sweep(
    backbones: Mapping[str, Backbone],
    candidates: Sequence[Candidate],
    scenes: Sequence[tuple[Path, tuple[str, ...]]],
    options: RelightOptions,
    store: ResultStore,
    perceptual: Perceptual | None,
) -> Iterator[Done]:
    """Make and score what the store does not have yet.

    Parameters
    ----------
    backbones : mapping of str to Backbone
        By name of the model.
    candidates : sequence of Candidate
        The exact plan first.
    scenes : sequence of (Path, tuple of str)
        Folders of scenes, each with its directions.
    options : RelightOptions
        What the candidates have in common.
    store : ResultStore
    perceptual : callable or None
        ST-LPIPS; None leaves it out.

    Yields
    ------
    Done
        After each direction of each scene.
    """
    made = relighters(backbones)
    for folder, names in scenes:
        wanted = {
            name: [c for c in candidates if not store.has(folder.name, name, c.name, c.how)]
            for name in names
        }
        if any(wanted.values()):
            for backbone in backbones.values():
                backbone.memory.clear()
            bench = _Bench(load_scene(folder, (DOMINANT, *AZIMUTHS)), made, options, perceptual)
        for name, missing in wanted.items():
            if missing:
                store.add(bench.results(name, candidates[0], missing))
            yield Done(folder.name, name)


def psnr(picture: FloatArray, truth: FloatArray, mask: BoolArray) -> float | None:
    """PSNR of a region in dB, as `spotlight_bench.metrics` has it; None where it is empty."""
    wanted, got = truth[mask].astype(np.float64), picture[mask].astype(np.float64)
    if not wanted.size:
        return None
    if float(np.square(wanted - got).mean()) <= 10.0 ** (-BEST_PSNR / 10.0):
        return BEST_PSNR
    return float(peak_signal_noise_ratio(wanted, got, data_range=1.0))


class _Bench:
    """One scene at work: its regions, the truths' shadings."""

    def __init__(
        self,
        test: TestScene,
        made: Mapping[str, Relighter],
        options: RelightOptions,
        perceptual: Perceptual | None,
    ) -> None:
        self._test, self._made, self._options = test, made, options
        self._perceptual = perceptual
        masks = regions(test.scene.object_mask)
        self._masks = {name: masks[name] for name in REGIONS}
        truths = test.truths if masks["foreground"].any() else None
        self._shadings = [following.shading(t, test.scene) for t in truths or ()]

    def results(self, name: str, exact: Candidate, missing: Sequence[Candidate]) -> list[Result]:
        """Pictures of one direction by several candidates, scored together."""
        (direction,) = (d for d in self._test.directions if d.name == name)
        reference, _ = self._picture(exact, direction)
        pictures, plans = zip(*(self._picture(each, direction) for each in missing))
        against_exact = self._scores(pictures, reference)
        against_truth: list[dict[str, float | None]] = [{} for _ in pictures]
        if direction.truth is not None:
            against_truth = self._scores(pictures, direction.truth)
        return [
            Result(
                scene=self._test.name,
                direction=name,
                method=candidate.name,
                how=candidate.how,
                scores={"truth": truth, "exact": same},
                following=self._following(picture, name),
                evaluations=plan.evaluations,
                seconds=round(plan.seconds or 0.0, 4),
            )
            for candidate, picture, plan, truth, same in zip(
                missing, pictures, plans, against_truth, against_exact
            )
        ]

    def _picture(self, candidate: Candidate, direction: Direction) -> tuple[FloatArray, Plan]:
        relighter = self._made[candidate.model]
        options = candidate.apply(self._options)
        result = relighter.relight(self._test.scene, guide_of(direction), options=options)
        levels = np.round(np.clip(result.image, 0.0, 1.0) * LEVELS)
        return levels.astype(np.float32) / LEVELS, result.plan

    def _scores(
        self, pictures: Sequence[FloatArray], truth: FloatArray
    ) -> list[dict[str, float | None]]:
        found: list[dict[str, float | None]] = [
            {f"{name}_psnr": psnr(each, truth, mask) for name, mask in self._masks.items()}
            for each in pictures
        ]
        front = self._masks["foreground"]
        if self._perceptual is None or not front.any():
            return found
        only = {"foreground": front}
        views = [isolated(each, truth, only)["foreground"] for each in pictures]
        for scores, distance in zip(found, self._perceptual(np.stack(views), truth)):
            scores["foreground_st_lpips"] = float(distance[front].mean(dtype=np.float64))
        return found

    def _following(self, picture: FloatArray, name: str) -> tuple[float, ...]:
        if name == DOMINANT or not self._shadings:
            return ()
        shown = following.shading(picture, self._test.scene)
        return tuple(following.distances(shown, self._shadings))
