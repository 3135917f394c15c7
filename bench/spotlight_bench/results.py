"""Results of single pictures, kept as JSON lines so that a run that was stopped goes on.

The first line says of which run the file is; each further line is one picture. A line is written
once its picture is scored, so at most the last line of a stopped run is not whole, and that one is
left out and made again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from spotlight_bench.errors import ResultsError
from spotlight_spec import RecordError, decode, encode, replacing

__all__ = ["RESULTS_FILE", "Result", "ResultStore"]

RESULTS_FILE: Final = "results.jsonl"

Key = tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Result:
    """One picture of one method.

    Attributes
    ----------
    scene, direction, method : str
    how : str
        The method's setting (`Method.how`).
    scores : dict
        By region and metric; empty where there is no truth.
    following, following_offset_free : tuple of float
        Distances of the object's shading from the truths of all eight azimuths
        (`spotlight_bench.following`); empty where they are not known.
    background_change : float or None
        Largest change of the photograph outside object and shadow.
    evaluations : int
        Of the denoiser, without those of the picture that all methods share.
    seconds : float
        To make this picture, by the clock; likewise.
    """

    scene: str
    direction: str
    method: str
    how: str
    scores: dict[str, dict[str, float | None]]
    following: tuple[float, ...] = ()
    following_offset_free: tuple[float, ...] = ()
    background_change: float | None = None
    evaluations: int = 0
    seconds: float = 0.0

    @property
    def key(self) -> Key:
        """What it is the result of."""
        return self.scene, self.direction, self.method


class ResultStore:
    """The results of a run, in memory and on disk.

    Parameters
    ----------
    path : Path
        The JSON-lines file.
    settings : dict
        What must be equal for results to belong together: model, steps, seed and so on.
    resume : bool
        Go on with a file that is there.

    Raises
    ------
    ResultsError
        If there are results and they are not to be resumed, are damaged, or are of other settings.
    """

    def __init__(self, path: Path, settings: dict[str, Any], *, resume: bool = False) -> None:
        self._path = path
        self._results: dict[Key, Result] = {}
        if path.is_file():
            if not resume:
                raise ResultsError(
                    f"{path}: there are results already; add --resume to go on with them, or name "
                    "another folder with -o"
                )
            self._read(settings)
        # Written anew, so that a line cut short does not run into the next one.
        lines = [{"settings": settings}, *(encode(r) for r in self._results.values())]
        with replacing(path) as partial:
            partial.write_text("".join(map(_line, lines)), encoding="utf-8")

    def __iter__(self) -> Iterator[Result]:
        return iter(self._results.values())

    def __len__(self) -> int:
        return len(self._results)

    def has(self, scene: str, direction: str, method: str, how: str) -> bool:
        """Whether this picture has been scored, with this setting of the method."""
        found = self._results.get((scene, direction, method))
        return found is not None and found.how == how

    def add(self, results: Iterable[Result]) -> None:
        """Keep results, on disk at once."""
        found = list(results)
        with self._path.open("a", encoding="utf-8") as file:
            file.write("".join(_line(encode(result)) for result in found))
        self._results |= {result.key: result for result in found}

    def _read(self, settings: dict[str, Any]) -> None:
        lines = self._path.read_text(encoding="utf-8").splitlines(keepends=True)
        if lines and not lines[-1].endswith("\n"):
            lines.pop()
        for number, line in enumerate(lines, start=1):
            try:
                value = json.loads(line)
                if number == 1:
                    self._check_settings(value["settings"], settings)
                    continue
                result = decode(Result, value, f"line {number}")
            except (ValueError, KeyError, TypeError, RecordError) as error:
                if isinstance(error, ResultsError):
                    raise
                raise ResultsError(
                    f"{self._path}: line {number} is damaged ({error}); delete the line, or name "
                    "another folder with -o"
                ) from error
            self._results[result.key] = result

    def _check_settings(self, found: dict[str, Any], wanted: dict[str, Any]) -> None:
        other = [name for name in wanted if found.get(name) != wanted[name]]
        if other:
            told = "; ".join(f"{n} {found.get(n)!r}, now {wanted[n]!r}" for n in other)
            raise ResultsError(
                f"{self._path}: these results are of another run: {told}. Name another folder with "
                "-o, or run with the same settings"
            )


def _line(value: dict[str, Any]) -> str:
    return json.dumps(value, allow_nan=False) + "\n"
