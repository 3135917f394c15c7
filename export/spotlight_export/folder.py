"""Model folders appear whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spotlight_export.errors import ModelFolderError, OutputFolderError
from spotlight_spec import MANIFEST_NAME, FileEntry, Manifest, RecordError, sha256_of

__all__ = ["file_entries", "new_model_folder", "read_model"]


@contextmanager
def new_model_folder(out: Path, *, force: bool = False) -> Iterator[Path]:
    """Fill a folder beside ``out`` and rename it to ``out`` when the block ends well.

    The working folder is called ``<out>.partial-<random>`` and has no manifest until it is
    complete, so an export that was killed never looks like a model, nor stands in the way of the
    next (in a container every process has the number of the one before). When the block fails,
    the working folder is removed.

    Parameters
    ----------
    out : Path
        Model folder to create. It may exist if it is empty; with ``force`` it may be a model
        folder, which is replaced.
    force : bool

    Raises
    ------
    OutputFolderError
        If ``out`` holds something else.
    """
    _check_replaceable(out, force)
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f"{out.name}.partial-", dir=out.parent))
    partial.chmod(0o755)  # mkdtemp makes folders that only their owner may enter
    try:
        yield partial
        if out.exists():
            retired = partial.with_name(partial.name.replace(".partial-", ".retired-"))
            out.rename(retired)
            partial.rename(out)
            (retired / MANIFEST_NAME).unlink(missing_ok=True)  # half removed, it is no model
            shutil.rmtree(retired)
        else:
            partial.rename(out)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def file_entries(folder: Path) -> tuple[FileEntry, ...]:
    """Size and sha256 of every file of a model folder but its manifest."""
    return tuple(
        FileEntry(path.name, path.stat().st_size, sha256_of(path))
        for path in sorted(folder.iterdir())
        if path.name != MANIFEST_NAME
    )


def read_model(folder: Path) -> Manifest:
    """Manifest of a model folder whose files are all as it says.

    Raises
    ------
    ModelFolderError
        If the folder is no model, or a file is missing or changed.
    """
    try:
        manifest = Manifest.read(folder)
    except (FileNotFoundError, RecordError) as error:
        raise ModelFolderError(
            f"{folder} is not a model folder ({error}); pass a folder that spotlight-export wrote"
        ) from error
    if problems := manifest.damaged_files(folder):
        raise ModelFolderError(f"{folder}: {'; '.join(problems)}. Export the model again")
    return manifest


def _check_replaceable(out: Path, force: bool) -> None:
    if not out.exists():
        return
    if not out.is_dir():
        raise OutputFolderError(f"{out} is a file; pass a folder for the model")
    names = sorted(path.name for path in out.iterdir())
    if names and MANIFEST_NAME not in names:
        raise OutputFolderError(
            f"{out} is not empty and not a model folder (it holds {names[0]!r}); pass an empty or "
            "new folder"
        )
    if names and not force:
        raise OutputFolderError(f"{out} already holds a model; pass --force to replace it")
