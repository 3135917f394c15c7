"""The ``spotlight-export`` command."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.table import Table
from typer.core import TyperGroup

from spotlight_spec import BACKBONES, Manifest, ParityRow

__all__ = ["app"]

Precision = Literal["fp32", "fp16", "int8"]
NAMES = ", ".join(
    ["zerocomp", *(n for n, spec in BACKBONES.items() if spec.conditioning_layout == "controlnet")]
)


class _BackboneOrCommand(TyperGroup):
    """A first word that is no command is a backbone to export."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            args = ["export", *args]
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=_BackboneOrCommand,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Turn a torch checkpoint into a model folder that `spotlight relight` runs on any CPU.",
    epilog="Start with:  spotlight-export zerocomp --base SD21_DIR --controlnet ZEROCOMP_DIR "
    "-o models/zerocomp    (then: spotlight-export verify models/zerocomp)",
)

Base = Annotated[
    str,
    typer.Option(help="Base model: folder with unet/ vae/ scheduler/ text_encoder/, or hub id."),
]
ControlNet = Annotated[
    str, typer.Option(help="ControlNet: its folder, the folder that holds controlnet/, or hub id.")
]
UNet = Annotated[
    str | None, typer.Option(help="Finetuned UNet to use instead of the base model's.")
]
Output = Annotated[Path, typer.Option("-o", "--output", help="Model folder to create.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the model already in the folder.")]
Moved = "if it moved since the export."


@app.command()
def export(
    backbone: Annotated[str, typer.Argument(help=f"One of {NAMES}.")],
    base: Base,
    controlnet: ControlNet,
    output: Output,
    unet: UNet = None,
    precision: Annotated[
        Precision,
        typer.Option(
            help="How weights are stored. fp16 halves the files; int8 is the fastest on CPUs with "
            "VNNI, and the least exact."
        ),
    ] = "fp32",
    layout: Annotated[
        Literal["fused", "split"],
        typer.Option(help="ControlNet and UNet as one graph, or two that run one after the other."),
    ] = "fused",
    verify: Annotated[
        bool, typer.Option("--verify/--no-verify", help="Compare with torch afterwards (quick).")
    ] = True,
    force: Force = False,
) -> None:
    """Export a backbone; the word `export` itself may be left out."""
    from spotlight_export.export import export_backbone

    with _progress() as report:
        manifest = export_backbone(
            backbone,
            base,
            controlnet,
            output,
            unet=unet,
            precision=precision,
            layout=layout,
            force=force,
            report=report,
            warn=lambda line: Console(stderr=True).print(f"warning: {line}", markup=False),
        )
    _summarise(output, manifest)
    if verify:
        _verify(output, full=False)


@app.command()
def verify(
    folder: Annotated[Path, typer.Argument(help="Model folder.")],
    base: Annotated[str | None, typer.Option(help=f"Base model, {Moved}")] = None,
    controlnet: Annotated[str | None, typer.Option(help=f"ControlNet, {Moved}")] = None,
    unet: Annotated[str | None, typer.Option(help=f"Finetuned UNet, {Moved}")] = None,
    full: Annotated[
        bool,
        typer.Option(
            "--full/--quick", help="All sizes, batches, timesteps and optimisation levels, or few."
        ),
    ] = True,
) -> None:
    """Compare a model with the checkpoint it came from; exit code 1 if it is past tolerance."""
    _verify(folder, full=full, base=base, controlnet=controlnet, unet=unet)


@app.command()
def quantise(
    folder: Annotated[Path, typer.Argument(help="Model folder of precision fp32.")],
    output: Output,
    precision: Annotated[
        Literal["fp16", "int8"], typer.Option(help="How weights are stored.")
    ] = "int8",
    force: Force = False,
) -> None:
    """Write an fp32 model again as fp16 or int8; needs no checkpoint."""
    from spotlight_export.convert import convert_model

    with _progress() as report:
        manifest = convert_model(folder, output, precision, force=force, report=report)
    _summarise(output, manifest)


def _verify(folder: Path, *, full: bool, **source: str | None) -> None:
    from spotlight_export.verify import past_tolerance, verify_model

    with _progress() as report:
        rows = verify_model(folder, full=full, report=report, **source)
    Console().print(_table(rows))
    if failed := past_tolerance(rows):
        worst = max(failed, key=lambda row: row.max_rel / row.tolerance)
        Console(stderr=True).print(
            f"{len(failed)} of {len(rows)} comparisons are past tolerance, worst {worst.subject} "
            f"({worst.case}): {worst.max_rel:.2g} > {worst.tolerance:.2g}",
            markup=False,
        )
        raise typer.Exit(1)


def _table(rows: tuple[ParityRow, ...]) -> Table:
    """One line per graph and optimisation level, with its worst case."""
    table = Table(title="torch float32 against ONNX Runtime, worst of all cases")
    for title in ("graph", "optimisation", "cases", "max abs", "max rel", "tolerance"):
        table.add_column(title, justify="left" if title in ("graph", "optimisation") else "right")
    groups: dict[tuple[str, str], list[ParityRow]] = {}
    for row in rows:
        groups.setdefault((row.subject, row.case.split(" · ")[0]), []).append(row)
    for (subject, level), group in groups.items():
        table.add_row(
            subject,
            level,
            str(len(group)),
            f"{max(row.max_abs for row in group):.2e}",
            f"{max(row.max_rel for row in group):.2e}",
            f"{group[0].tolerance:.0e}",
        )
    return table


def _summarise(folder: Path, manifest: Manifest) -> None:
    size = sum(entry.bytes for entry in manifest.files) / 1e6
    lines = [f"{folder}: {manifest.backbone.name}, {manifest.precision}, {size:.0f} MB"]
    lines += [f"  {what}: {value}" for what, value in manifest.provenance.items()]
    Console().print("\n".join(lines), markup=False)


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A spinner that says what is being done."""
    console = Console(stderr=True)
    with console.status("starting") as status:
        yield status.update
