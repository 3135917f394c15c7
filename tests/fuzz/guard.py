"""What every parser promises, checked around each execution.

It returns or raises a documented error; nothing else, within a time and within a bound of memory;
no file outside its folder is written or read, no socket is opened and no process is started.
"""

from __future__ import annotations

import faulthandler
import os
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import spotlight_runtime
import spotlight_spec
from fuzz.targets import REFUSALS, Target
from spotlight_runtime.composing import gltf, product
from spotlight_runtime.imaging import headers

__all__ = ["MOST_MEMORY", "BrokenPromiseError", "Guard", "peak_memory"]

MOST_SECONDS = 30
"""Of one execution, on a machine that is busy; they take milliseconds."""
PICTURE_PIXELS = 1 << 20
"""What the runtime's limit on pictures is lowered to, so that its memory can be bounded tightly."""
TRIANGLES = 100_000
"""Likewise, of models."""
MOST_MEMORY = 512 << 20
"""Bytes above what the imports take: a picture of `PICTURE_PIXELS` as floats, thirty times over."""
_PACKAGES = tuple(str(Path(p.__file__).parent) for p in (spotlight_runtime, spotlight_spec))
"""Whose modules may be imported on first use."""
_SYSTEM = (
    *_PACKAGES,
    sys.prefix,
    sys.base_prefix,
    "/usr",
    "/lib",
    "/proc",
    "/sys",
    "/dev/",
    "/etc/",
)
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_CHANGES = {"os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.symlink", "os.link", "os.chmod"}
_NEVER = {"socket.connect", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn"}


class BrokenPromiseError(AssertionError):
    """A parser did what none may."""


class Guard:
    """One target in a folder of its own.

    Parameters
    ----------
    target : Target
    folder : Path
        Empty; all that is read and written lies here.
    """

    def __init__(self, target: Target, folder: Path) -> None:
        self._folder = folder.resolve()
        scratch = self._folder / "scratch"
        scratch.mkdir(parents=True)
        self._home = self._folder / "home"
        self._home.mkdir()
        tempfile.tempdir = str(scratch)
        headers.MAX_PIXELS = PICTURE_PIXELS
        headers.MAX_SAMPLES = 8 * PICTURE_PIXELS
        product.MAX_TRIANGLES = gltf.MAX_SPARSE = TRIANGLES
        self._scratch = scratch
        os.chdir(scratch.parent)  # a name taken relative to here is inside, and there is nothing
        self._watching = False
        self._seen: list[str] = []
        self._run, starts = target.make(self._home)
        self.starts = list(starts)
        self.refused = 0
        self.executions = 0
        sys.addaudithook(self._notice)
        warnings.simplefilter("error")

    def __call__(self, data: bytes) -> None:
        """Run the parser once.

        Raises
        ------
        BrokenPromiseError
        """
        self.executions += 1
        self._seen.clear()
        faulthandler.dump_traceback_later(MOST_SECONDS, exit=True)
        self._watching = True
        try:
            self._run(data)
        except REFUSALS:
            self.refused += 1
        except Exception as error:
            self._watching = False  # a traceback reads the sources
            said = "".join(traceback.format_exception(error))
            raise BrokenPromiseError(
                f"{type(error).__name__} is no error of the runtime\n{said}"
            ) from error
        finally:
            self._watching = False
            faulthandler.cancel_dump_traceback_later()
        if self._seen:
            raise BrokenPromiseError(f"went outside its folder: {self._seen}")
        if left := os.listdir(self._scratch):
            raise BrokenPromiseError(f"left {left} in the temporary folder")

    def _notice(self, event: str, arguments: tuple[object, ...]) -> None:
        if not self._watching:
            return
        if event in _NEVER:
            self._seen.append(f"{event} {arguments!r}")
        elif event == "open":
            path, mode, flags = arguments
            writes = (isinstance(mode, str) and set(mode) & set("wax+")) or (
                isinstance(flags, int) and flags & _WRITES
            )
            self._check(event, path, reading=not writes)
        elif event in _CHANGES:
            self._check(event, arguments[0], reading=False)

    def _check(self, event: str, path: object, *, reading: bool) -> None:
        if not isinstance(path, str | bytes | os.PathLike):
            return  # a descriptor of what was opened before
        where = os.path.abspath(os.fsdecode(path))
        inside = where.startswith(str(self._folder) + os.sep)
        if not inside and not (reading and where.startswith(_SYSTEM)):
            self._seen.append(f"{event} {where}")


def peak_memory(work: Callable[[], None]) -> int:
    """Bytes by which the process's largest resident size grew over its present one."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    before = _resident("VmRSS")
    work()
    return _resident("VmHWM") - before


def _resident(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith(name + ":"))
