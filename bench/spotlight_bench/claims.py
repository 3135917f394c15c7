"""What the paper and this project claim, held against the figures of an evaluation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from spotlight_bench.methods import OURS
from spotlight_bench.metrics import METRICS
from spotlight_bench.statistics import Estimate, difference
from spotlight_bench.summary import Summary, Task

__all__ = ["Claim", "check_claims"]

PAPER: Final = {"psnr": 30.7, "ssim": 0.974, "rmse": 0.033, "mae": 0.012}
"""SpotLight's figures on the published set, reference-based, full image; LPIPS is of another
network."""
LABELS: Final = {metric.name: metric.label for metric in METRICS}
TOP_1: Final = 0.80
WITHIN_45: Final = 0.95
ONE_LEVEL: Final = 1.0 / 255.0


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim, the figures that speak for or against it, and whether it holds."""

    text: str
    found: str
    holds: bool


def check_claims(summary: Summary) -> tuple[Claim, ...]:
    """The claims that these figures can decide."""
    return tuple(
        claim
        for group in (_levels, _ahead, _following, _ablation, _background)
        for claim in group(summary)
    )


def _levels(summary: Summary) -> Iterator[Claim]:
    for metric, level in PAPER.items():
        found = summary.figure(OURS, "reference-based", "full", metric)
        if found is not None:
            more = metric in ("psnr", "ssim")
            mean = found.estimate.mean
            yield Claim(
                f"reference-based, full image: {LABELS[metric]} {'≥' if more else '≤'} {level}",
                f"{mean:.4g}",
                mean >= level if more else mean <= level,
            )


def _ahead(summary: Summary) -> Iterator[Claim]:
    """Ahead of the baselines on the object, where there is something to control."""
    task: Task = "user-controlled"
    for baseline in ("no-control", "sdedit"):
        for metric, sign in (("psnr", 1.0), ("st_lpips", -1.0)):
            ours = summary.figure(OURS, task, "foreground", metric)
            theirs = summary.figure(baseline, task, "foreground", metric)
            if ours is None or theirs is None:
                continue
            paired = difference(ours.scenes, theirs.scenes)
            if paired is None:
                continue
            apart = (
                ours.estimate.low > theirs.estimate.high
                if sign > 0
                else ours.estimate.high < theirs.estimate.low
            )
            yield Claim(
                f"user-controlled, foreground: {LABELS[metric]} ahead of {baseline}, "
                "intervals apart",
                f"{_interval(ours.estimate)} against {_interval(theirs.estimate)}; "
                f"difference {_interval(paired)}",
                apart,
            )


def _following(summary: Summary) -> Iterator[Claim]:
    task: Task = "user-controlled"
    for metric, level, label in (
        ("top_1", TOP_1, "top-1"),
        ("within_45", WITHIN_45, "within ±45°"),
    ):
        found = summary.figure(OURS, task, "foreground", metric)
        if found is not None:
            mean = found.estimate.mean
            yield Claim(f"light following: {label} ≥ {level:.0%}", f"{mean:.1%}", mean >= level)
    ours = summary.figure(OURS, task, "foreground", "top_1")
    weak = summary.figure("gamma-1", task, "foreground", "top_1")
    if ours is not None and weak is not None:
        yield Claim(
            "light following: γ=3 above γ=1 (top-1)",
            f"{ours.estimate.mean:.1%} against {weak.estimate.mean:.1%}",
            ours.estimate.mean > weak.estimate.mean,
        )


def _ablation(summary: Summary) -> Iterator[Claim]:
    for method, text in (("gamma-7", "from γ=3 to γ=7"), ("beta-0.2", "from β=0.05 to β=0.2")):
        ours = summary.figure(OURS, "reference-based", "full", "psnr")
        other = summary.figure(method, "reference-based", "full", "psnr")
        if ours is not None and other is not None:
            yield Claim(
                f"reference-based, full image: PSNR falls {text}",
                f"{ours.estimate.mean:.2f} to {other.estimate.mean:.2f} dB",
                other.estimate.mean < ours.estimate.mean,
            )


def _background(summary: Summary) -> Iterator[Claim]:
    change = summary.worst_background_change.get(OURS)
    if change is not None:
        yield Claim(
            "background outside object and shadow unchanged (largest difference ≤ 1/255)",
            f"{change * 255:.2f}/255",
            change <= ONE_LEVEL,
        )


def _interval(found: Estimate) -> str:
    return f"{found.mean:.4g} [{found.low:.4g}, {found.high:.4g}]"
