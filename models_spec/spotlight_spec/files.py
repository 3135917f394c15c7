"""Write-then-rename: a reader never meets half a file, whatever happens to the writer."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["replacing"]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a name beside ``path`` to write to, which takes its place when the block succeeds.

    No other writer uses that name, so two may write the same file at once: the later one wins,
    whole. If the block fails, nothing of it is left.

    Raises
    ------
    OSError
        If the folder cannot be written to.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".partial")
    except OSError as error:
        error.filename = str(path)  # the name its caller knows
        raise
    os.close(handle)
    partial = Path(name)
    try:
        partial.chmod(0o644)  # mkstemp makes files that only their owner may read
        yield partial
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
