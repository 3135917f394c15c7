"""``spotlight-bench pareto``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from spotlight_bench import arguments as a

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from spotlight_bench.backbone import Backbone
    from spotlight_bench.pareto_grid import Candidate
    from spotlight_bench.pareto_summary import Point
    from spotlight_bench.pareto_timing import Timing
    from spotlight_runtime import RelightOptions

__all__ = ["pareto"]

SCENES: Final = 30
AZIMUTHS: Final = 4
SCREEN_SCENES: Final = 4
SCREEN_AZIMUTHS: Final = 2
ROUNDS: Final = 7
QUICK_SCENES: Final = 2
QUICK_AZIMUTHS: Final = 1
QUICK_ROUNDS: Final = 2
PIPED_WIDTH: Final = 160
"""Columns where the output is no terminal, so that no figure is cut off."""

Scenes = list[tuple[Path, tuple[str, ...]]]


def pareto(
    data: Annotated[
        Path, typer.Argument(metavar="TESTSET", help="Test set with truths: a folder a scene.")
    ],
    model: Annotated[
        list[str] | None,
        typer.Option(
            help="Model name or folder. Repeatable: others, of another precision say, are held "
            "against the first.",
            show_default="mini",
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for tables, plots and results.")
    ] = Path("pareto"),
    scenes: Annotated[
        int | None, typer.Option(min=1, help="Scenes.", show_default=str(SCENES))
    ] = None,
    screen: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Scenes on which the whole grid is tried first; 0: on all.",
            show_default=str(SCREEN_SCENES),
        ),
    ] = None,
    azimuths: Annotated[
        int | None,
        typer.Option(
            min=0, max=8, help="Lights a scene besides its own.", show_default=str(AZIMUTHS)
        ),
    ] = None,
    rounds: Annotated[
        int | None,
        typer.Option(min=1, help="Times each is run by the clock.", show_default=str(ROUNDS)),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A small grid on two scenes: under five minutes.")
    ] = False,
    resume: a.Resume = False,
    ladder: Annotated[
        Path | None, typer.Option(help="Write the ladder of plans here as well.")
    ] = None,
    json_file: a.JsonFile = None,
    threads: a.Threads = None,
) -> None:
    """Measure what accuracy costs in time: curve, table and the ladder that budgets climb.

    Example: spotlight-bench pareto testset --quick -o quick
    """
    from spotlight_bench.backbone import Backbone
    from spotlight_bench.dataset import fingerprint
    from spotlight_bench.pareto_grid import FULL, QUICK, candidates
    from spotlight_bench.perceptual import PerceptualDistance
    from spotlight_runtime import RelightOptions
    from spotlight_runtime.networks.sessions import available_cpus

    threads = threads or available_cpus()
    opened = [Backbone.load(name, threads) for name in model or ["mini"]]
    names = tuple(backbone.facts["name"] for backbone in opened)
    own_steps = opened[0].spec.schedule.steps
    reusing = [each.facts["name"] for each in opened if "denoiser_shallow" in each.networks]
    chosen = candidates(QUICK if quick else FULL, own_steps, names, reusing)
    backbones = dict(zip(names, opened))
    run = _Run(backbones, RelightOptions(), fingerprint(data), output, resume)
    size = _or(scenes, QUICK_SCENES if quick else SCENES)
    lights = _or(azimuths, QUICK_AZIMUTHS if quick else AZIMUTHS)
    first = _or(screen, 0 if quick else SCREEN_SCENES)
    output.mkdir(parents=True, exist_ok=True)
    if first:
        chosen = run.screened(chosen, _scenes(data, first, min(lights, SCREEN_AZIMUTHS)))
    work = _scenes(data, size, lights)
    found = run.swept("results.jsonl", chosen, work, PerceptualDistance(threads))
    timed = _take_times(
        backbones, chosen, [f for f, _ in work], run.options,
        _or(rounds, QUICK_ROUNDS if quick else ROUNDS),
    )  # fmt: skip
    memory = _memory(dict(zip(names, model or ["mini"])), chosen, work[0][0], threads)
    settings = {
        "models": ", ".join(f"{n} ({b.facts['precision']})" for n, b in backbones.items()),
        "data": data.name,
        "scenes": len(work),
        "pictures": sum(len(each) for _, each in work),
        "threads": threads,
    }
    _report(output, ladder, json_file, _Found(chosen, found, timed, memory), settings)


@dataclass(frozen=True)
class _Found:
    candidates: Sequence[Candidate]
    results: Sequence[Any]
    timings: Sequence[Timing]
    memory: Mapping[str, int | None]


@dataclass(frozen=True)
class _Run:
    """What every sweep of one command has in common."""

    backbones: Mapping[str, Backbone]
    options: RelightOptions
    data_fingerprint: str
    output: Path
    resume: bool

    def screened(self, chosen: Sequence[Candidate], work: Scenes) -> tuple[Candidate, ...]:
        """Those of the grid that are worth all scenes."""
        from spotlight_bench.pareto_summary import points, survivors

        found = self.swept("screening.jsonl", chosen, work, None)
        return survivors(points(found, chosen))

    def swept(self, file: str, chosen: Sequence[Candidate], work: Scenes, metric: Any) -> list[Any]:
        """Results of these candidates on these scenes."""
        from spotlight_bench.pareto import sweep
        from spotlight_bench.results import ResultStore

        settings = {
            "models": [
                f"{name} {each.facts['fingerprint']} {each.facts['precision']}"
                for name, each in self.backbones.items()
            ],
            "st_lpips": metric is not None,
            "data_fingerprint": self.data_fingerprint,
            "version": version("spotlight-relight"),
        }
        there = (self.output / file).is_file()
        store = ResultStore(self.output / file, settings, resume=self.resume and there)
        run = sweep(self.backbones, chosen, work, self.options, store, metric)
        _with_progress(run, sum(len(names) for _, names in work), f"{len(chosen)} candidates")
        wanted = {(folder.name, name) for folder, names in work for name in names}
        return [result for result in store if result.key[:2] in wanted]


def _scenes(data: Path, count: int, azimuths: int) -> Scenes:
    from spotlight_bench.dataset import AZIMUTHS as EIGHT
    from spotlight_bench.dataset import DOMINANT, find_scenes, has_directions
    from spotlight_bench.errors import DataError
    from spotlight_bench.pareto import directions_of

    folders = [f for f in find_scenes(data) if has_directions(f, (DOMINANT, *EIGHT))][:count]
    if not folders:
        raise DataError(
            f"{data}: expected scenes with the shadows of gt_dir and eight azimuths, found none; "
            "render a set with `spotlight-train render --evaluation`, then `export-testset`"
        )
    return [(folder, directions_of(index, azimuths)) for index, folder in enumerate(folders)]


def _take_times(
    backbones: Mapping[str, Backbone],
    chosen: Sequence[Candidate],
    folders: Sequence[Path],
    options: RelightOptions,
    rounds: int,
) -> list[Timing]:
    from spotlight_bench.pareto_timing import take_times

    found: list[Timing] = []
    run = (found.append(each) for each in take_times(backbones, chosen, folders, options, rounds))
    _with_progress(run, rounds * len(chosen), "by the clock")
    return found


def _memory(
    models: Mapping[str, str], chosen: Sequence[Candidate], folder: Path, threads: int
) -> dict[str, int | None]:
    """Peak memory by candidate: of one a model and window, which is what it depends on."""
    from spotlight_bench.pareto_timing import peak_memory

    measured: dict[tuple[str, str], int | None] = {}
    found = {}
    for each in chosen:
        kind = (each.model, each.options.get("window", "auto"))
        if kind not in measured:
            measured[kind] = peak_memory(models[each.model], each, folder, threads)
        found[each.name] = measured[kind]
    return found


def _report(
    output: Path, ladder: Path | None, json_file: Path | None, found: _Found, settings: Any
) -> None:
    from rich.console import Console

    from spotlight_bench import pareto_ladder, pareto_report
    from spotlight_bench.pareto_plot import plot
    from spotlight_bench.pareto_summary import front, points
    from spotlight_spec import replacing, write_json

    marked = front(points(found.results, found.candidates, found.timings, found.memory))
    rungs = pareto_ladder.name_rungs(marked)
    names = {point.candidate.name: point.rung for point in rungs}
    claims = pareto_ladder.claims(rungs)
    texts = {
        "pareto.csv": pareto_report.as_csv(_named(marked, names)),
        "pareto.md": pareto_report.as_markdown(rungs, claims, settings),
    }
    for name, text in texts.items():
        with replacing(output / name) as partial:
            partial.write_text(text, encoding="utf-8")
    record = pareto_ladder.ladder_record(marked, settings)
    for path in (output / "ladder.json", *([] if ladder is None else [ladder])):
        write_json(path, record)
    if json_file is not None:
        everything = pareto_report.as_json(marked, found.timings, claims, settings)
        write_json(json_file, everything)
    title = f"{settings['models']}, {settings['pictures']} pictures"
    plot(marked, rungs, [output / "pareto.svg", output / "pareto.png"], title)
    console = Console(width=None if sys.stdout.isatty() else PIPED_WIDTH)
    console.print(pareto_report.as_rich(rungs))
    for text, holds in claims:
        console.print(f"{'holds' if holds else 'FAILS'}  {text}")
    written = sorted(path.name for path in output.iterdir() if path.is_file())
    console.print(f"{output}: {', '.join(written)}")


def _named(found: Sequence[Point], names: Mapping[str, str]) -> list[Point]:
    from dataclasses import replace

    return [replace(point, rung=names.get(point.candidate.name, "")) for point in found]


def _or(given: int | None, otherwise: int) -> int:
    return otherwise if given is None else given


def _with_progress(run: Any, total: int, what: str) -> None:
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=total)
        for _ in run:
            bar.update(task, advance=1)
