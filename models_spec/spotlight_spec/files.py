"""Write-then-rename: a reader never meets half a file, whatever happens to the writer."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["alone_in", "replacing"]


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Wait until no other process is in a block of this kind with the folder, and keep them out.

    The lock ends with the process that holds it, however that ends, and leaves no file behind.
    Where the system or the file system has no such locks, nothing is waited for.
    """
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@contextmanager
def replacing(path: Path, *, keep_suffix: bool = False) -> Iterator[Path]:
    """Yield a name beside ``path`` to write to, which takes its place when the block succeeds.

    No other writer uses that name, so two may write the same file at once: the later one wins,
    whole. If the block fails, nothing of it is left. Of a link, the file that it leads to is
    replaced; a pipe or a device is written to as it is.

    Parameters
    ----------
    path : Path
    keep_suffix : bool
        The name ends as the path's does, for writers that tell formats by it.

    Raises
    ------
    OSError
        If the folder cannot be written to.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = Path(os.path.realpath(path))
    suffix = ".partial" + (path.suffix if keep_suffix else "")
    partial = target.with_name(f".{target.name}.{secrets.token_hex(4)}{suffix}")
    try:
        partial.touch(exist_ok=False)  # with the rights that the umask leaves, not mkstemp's
    except OSError as error:
        error.filename = str(path)  # the name its caller knows
        raise
    try:
        yield partial
        partial.replace(target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
