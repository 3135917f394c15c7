"""One evaluation: every wanted picture of every method, made and scored.

`evaluate` is a generator that yields after each direction of each scene; close it to stop, and
run it again on the same `ResultStore` to go on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from spotlight_bench import following
from spotlight_bench.backbone import Backbone
from spotlight_bench.dataset import (
    AZIMUTHS,
    DOMINANT,
    Direction,
    TestScene,
    find_scenes,
    has_directions,
    load_scene,
)
from spotlight_bench.errors import DataError, MethodError
from spotlight_bench.methods import Method
from spotlight_bench.metrics import background_change, isolated, regions, scores
from spotlight_bench.pictures import Made, Studio, foreign_file
from spotlight_bench.results import Result, ResultStore
from spotlight_runtime import RelightOptions, write_image
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import linear_to_srgb

__all__ = ["Done", "Perceptual", "Work", "evaluate", "picture_file", "plan"]

Perceptual = Callable[[FloatArray, FloatArray], FloatArray]
"""``maps = perceptual(pictures (N, H, W, 3), truth (H, W, 3))``, maps (N, H, W)."""
Scores = dict[str, dict[str, float | None]]
IMAGES_FOLDER: Final = "images"
LEVELS: Final = np.float32(255.0)
"""Of the 8-bit PNG that every picture is scored as: what another method's folder holds too."""


@dataclass(frozen=True, slots=True)
class Work:
    """What is to be done on one scene."""

    folder: Path
    directions: tuple[str, ...]
    keep_images: bool = False


@dataclass(frozen=True, slots=True)
class Done:
    """One direction of one scene has been scored."""

    scene: str
    direction: str


def plan(
    data: Path, scenes: int | None, user_scenes: int, shown: int, *, keep_images: bool = False
) -> tuple[Work, ...]:
    """Work on a test set.

    Parameters
    ----------
    data : Path
    scenes : int or None
        Scenes of the reference-based evaluation; None: all.
    user_scenes : int
        Scenes of the user-controlled one; those that have eight azimuths count.
    shown : int
        So many first scenes keep their pictures for the sheet.
    keep_images : bool
        All do.

    Raises
    ------
    DataError
        If nothing is left to do.
    """
    found = find_scenes(data)
    reference = [folder for folder in found if has_directions(folder, (DOMINANT,))][:scenes]
    user = [folder for folder in found if has_directions(folder, AZIMUTHS)][:user_scenes]
    work: list[Work] = []
    for folder in sorted({*reference, *user}):
        directions = (DOMINANT,) * (folder in reference) + AZIMUTHS * (folder in user)
        work.append(Work(folder, directions, keep_images or len(work) < shown))
    if not work:
        raise DataError(
            f"{data}: expected shadow_positive_{DOMINANT}.png, or shadow_positive_0000.png to "
            "_0007.png, in the scenes' folders, found neither; cast them with `spotlight shadow`"
        )
    return tuple(work)


def check_folders(methods: Sequence[Method], work: Sequence[Work]) -> None:
    """Raise unless methods from folders have their pictures, before hours of computing.

    A method may lack the reference-based or the user-controlled pictures altogether; then it is
    left out there.

    Raises
    ------
    MethodError
        If it has some of them and lacks others, or has none at all.
    """
    pairs = [(item.folder.name, name) for item in work for name in item.directions]
    tasks = {
        "reference-based": [pair for pair in pairs if pair[1] == DOMINANT],
        "user-controlled": [pair for pair in pairs if pair[1] != DOMINANT],
    }
    for method in (m for m in methods if m.kind == "folder"):
        lacking = {pair for pair in pairs if foreign_file(method, *pair) is None}
        for task, wanted in tasks.items():
            gone = [pair for pair in wanted if pair in lacking]
            if gone and (len(gone) < len(wanted) or len(lacking) == len(pairs)):
                raise MethodError(
                    f"method {method.name}: expected {method.folder}/{gone[0][0]}/{gone[0][1]}.png,"
                    f" found {len(wanted) - len(gone)} of {len(wanted)} {task} pictures; add them"
                )


def evaluate(
    backbone: Backbone,
    methods: Sequence[Method],
    work: Sequence[Work],
    options: RelightOptions,
    store: ResultStore,
    output: Path,
    perceptual: Perceptual | None,
) -> Iterator[Done]:
    """Make and score what the store does not have yet.

    Parameters
    ----------
    backbone : Backbone
    methods : sequence of Method
    work : sequence of Work
        See `plan`.
    options : RelightOptions
        γ and β are the methods' own.
    store : ResultStore
    output : Path
        Pictures are written to ``images/METHOD/SCENE/DIRECTION.png`` below it: those of the scenes
        that keep them, and all that there is no truth for.
    perceptual : callable or None
        ST-LPIPS; None leaves it out.

    Yields
    ------
    Done
        After each direction of each scene.

    Raises
    ------
    BenchError, SpotLightError
        Naming what is missing or failed.
    """
    check_folders(methods, work)
    for item in work:
        wanted = {
            direction: [m for m in methods if not _finished(store, item, direction, m)]
            for direction in item.directions
        }
        if any(wanted.values()):
            test = load_scene(item.folder, item.directions)
            session = _Session(test, Studio(backbone, test, options), output, item, perceptual)
        for direction, missing in wanted.items():
            if missing:
                store.add(session.results(direction, missing))
            yield Done(item.folder.name, direction)


def picture_file(output: Path, method: str, scene: str, direction: str) -> Path:
    """Where the picture of a method lies."""
    return output / IMAGES_FOLDER / method / scene / f"{direction}.png"


def _finished(store: ResultStore, item: Work, direction: str, method: Method) -> bool:
    scene = item.folder.name
    if store.has(scene, direction, method.name, method.how):
        return True
    return method.kind == "folder" and foreign_file(method, scene, direction) is None


class _Session:
    """One scene at work: its studio, regions and the truths' shadings."""

    def __init__(
        self,
        test: TestScene,
        studio: Studio,
        output: Path,
        item: Work,
        perceptual: Perceptual | None,
    ) -> None:
        self._test = test
        self._studio = studio
        self._output = output
        self._keep = item.keep_images
        self._perceptual = perceptual
        self._regions = regions(test.scene.object_mask)
        self._photograph = linear_to_srgb(test.scene.background)
        truths = test.truths if self._regions["foreground"].any() else None
        self._shadings = [following.shading(t, test.scene) for t in truths or ()]

    def results(self, name: str, methods: Sequence[Method]) -> list[Result]:
        """Pictures of one direction by several methods, scored together."""
        (direction,) = (d for d in self._test.directions if d.name == name)
        self._studio.prepare(methods)
        made, seconds = [], []
        for method in methods:
            start = time.perf_counter()
            picture = self._studio.picture(method, direction)
            seconds.append(time.perf_counter() - start)
            made.append(replace(picture, image=_eight_bit(picture.image)))
            if self._keep or direction.truth is None:
                path = picture_file(self._output, method.name, self._test.name, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                write_image(path, made[-1].image)
        found = self._scores([one.image for one in made], direction)
        return [self._result(direction, *one) for one in zip(methods, made, seconds, found)]

    def _scores(self, pictures: Sequence[FloatArray], direction: Direction) -> list[Scores]:
        truth = direction.truth
        if truth is None:
            return [{} for _ in pictures]
        views = [isolated(picture, truth, self._regions) for picture in pictures]
        maps: list[dict[str, FloatArray]] = [{} for _ in views]
        if self._perceptual is not None:
            # All at once, so that the truth goes through the network once.
            flat = iter(
                self._perceptual(np.stack([v for view in views for v in view.values()]), truth)
            )
            maps = [{region: next(flat) for region in view} for view in views]
        return [scores(view, truth, self._regions, own) for view, own in zip(views, maps)]

    def _result(
        self,
        direction: Direction,
        method: Method,
        made: Made,
        seconds: float,
        found: Scores,
    ) -> Result:
        scene = self._test.scene
        result = Result(
            scene=self._test.name,
            direction=direction.name,
            method=method.name,
            how=method.how,
            scores=found,
            background_change=background_change(
                made.image, self._photograph, scene.object_mask, direction.shadow
            ),
            evaluations=made.evaluations,
            seconds=round(seconds, 4),
        )
        if direction.name == DOMINANT or not self._shadings:
            return result
        shown = following.shading(made.image, scene)
        return replace(
            result,
            following=tuple(following.distances(shown, self._shadings)),
            following_offset_free=tuple(
                following.distances(shown, self._shadings, offset_free=True)
            ),
        )


def _eight_bit(picture: FloatArray) -> FloatArray:
    return np.round(np.clip(picture, 0.0, 1.0) * LEVELS).astype(np.float32) / LEVELS
