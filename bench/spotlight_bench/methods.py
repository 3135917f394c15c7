"""The methods that are compared, by name."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from spotlight_bench.errors import MethodError
from spotlight_runtime.planning.ladder import PlanName, named_rung

__all__ = ["BUILT_IN", "OURS", "QUICK", "Method", "choose"]

Kind = Literal["spotlight", "no-control", "sdedit", "pasted", "folder"]


@dataclass(frozen=True, slots=True)
class Method:
    """One way to put the object into the photograph.

    Attributes
    ----------
    name : str
        On the command line, in results and in folders.
    label : str
        In tables.
    kind : {"spotlight", "no-control", "sdedit", "pasted", "folder"}
        ``no-control``: the renderer alone (ZeroComp), shading hidden under the object, no shadow.
        ``sdedit``: ZeroComp+SDEdit (`spotlight_bench.sdedit`). ``pasted``: albedo × flat light.
        ``folder``: pictures that another program made.
    gamma, beta : float
        γ and β of ``spotlight``.
    negative : {"opposite", "none"}
        Shadow of the negative branch of ``spotlight``.
    plan : {"exact", "balanced", "draft"}
        Plan of ``spotlight``: what a short one costs against the truth.
    seed : int, optional
        Of its noise, where it is to be another than the evaluation's: what a seed decides.
    folder : str
        Where the pictures of ``folder`` lie.
    """

    name: str
    label: str
    kind: Kind = "spotlight"
    gamma: float = 3.0
    beta: float = 0.05
    negative: Literal["opposite", "none"] = "opposite"
    plan: PlanName = "exact"
    seed: int | None = None
    folder: str = ""

    @property
    def how(self) -> str:
        """What sets its pictures apart, so that stored results of another setting are not used."""
        if self.kind == "folder":
            return f"folder {self.folder}"
        if self.kind != "spotlight":
            return self.kind
        how = f"spotlight gamma={self.gamma:g} beta={self.beta:g} negative={self.negative}"
        if self.seed is not None:
            how += f" seed={self.seed}"
        if self.plan == "exact":
            return how
        # What the plan is today, on a model that reuses deep features and on one that cannot.
        means = (json.dumps(named_rung(self.plan, each).options) for each in (True, False))
        return f"{how} {self.plan}={' or '.join(means)}"


OURS: Final = "spotlight"
_METHODS: Final = (
    Method("pasted", "pasted object", "pasted"),
    Method("no-control", "no control (ZeroComp)", "no-control"),
    Method("sdedit", "ZeroComp+SDEdit", "sdedit"),
    Method(OURS, "SpotLight γ=3 β=0.05"),
    Method("balanced", "balanced plan", plan="balanced"),
    Method("draft", "draft plan", plan="draft"),
    Method("seed-1", "seed 1", seed=1),
    Method("gamma-1", "γ=1", gamma=1.0),
    Method("gamma-7", "γ=7", gamma=7.0),
    Method("beta-0", "β=0", beta=0.0),
    Method("beta-0.2", "β=0.2", beta=0.2),
    Method("negative-none", "negative: no shadow", negative="none"),
)
BUILT_IN: Final = {method.name: method for method in _METHODS}
QUICK: Final = ("pasted", "no-control", "sdedit", OURS, "gamma-1")


def choose(names: Iterable[str], folders: Sequence[str] = ()) -> tuple[Method, ...]:
    """Methods by name, built in and from folders.

    Parameters
    ----------
    names : iterable of str
        Of `BUILT_IN`.
    folders : sequence of str
        ``NAME=FOLDER`` of other methods' pictures.

    Returns
    -------
    tuple of Method
        Built-in ones in the order of the tables, then the folders' as given.

    Raises
    ------
    MethodError
        If a name is unknown or taken, or a folder does not exist.
    """
    wanted = set(names)
    unknown = sorted(wanted - set(BUILT_IN))
    if unknown:
        raise MethodError(
            f"methods: expected some of {', '.join(BUILT_IN)}, got {', '.join(unknown)}; pictures "
            "of another method come in with --method NAME=FOLDER"
        )
    chosen = [method for name, method in BUILT_IN.items() if name in wanted]
    for entry in folders:
        method = _from_folder(entry)
        if method.name in BUILT_IN or method.name in (other.name for other in chosen):
            raise MethodError(f"method {entry!r}: the name {method.name} is taken; choose another")
        chosen.append(method)
    if not chosen:
        raise MethodError(f"methods: expected at least one of {', '.join(BUILT_IN)}, got none")
    return tuple(chosen)


def _from_folder(entry: str) -> Method:
    name, separator, folder = entry.partition("=")
    if not separator or not name or not folder or "/" in name or name.startswith("."):
        raise MethodError(f"method: expected NAME=FOLDER, got {entry!r}")
    if not Path(folder).is_dir():
        raise MethodError(f"method {name}: expected a folder of pictures, but there is no {folder}")
    return Method(name, name, "folder", folder=folder)
