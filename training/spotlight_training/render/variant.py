"""Chooses the renderer's back end: CUDA where it works, else LLVM on the CPU."""

from __future__ import annotations

import ctypes.util
import os
from pathlib import Path

VARIANTS = {"cuda": "cuda_ad_rgb", "llvm": "llvm_ad_rgb"}
OLDEST_LLVM, NEWEST_LLVM = 16, 21
REMEDY = (
    "Install it with 'apt-get install libllvm19', or set DRJIT_LIBLLVM_PATH to the shared "
    "library of LLVM 16 or newer."
)
_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/opt/homebrew/opt/llvm/lib",
)


class RendererUnavailableError(RuntimeError):
    """The rendering library or the compiler that it needs is not installed."""


def select_variant(name: str = "auto", threads: int | None = None) -> str:
    """Set the renderer's variant for this process and return its short name.

    Parameters
    ----------
    name : {'auto', 'cuda', 'llvm'}
        'auto' takes CUDA where a kernel runs on it, else LLVM.
    threads : int, optional
        CPU threads; all of them if not given.

    Raises
    ------
    RendererUnavailableError
        If Mitsuba is missing, or nothing that was asked for works.
    ValueError
        If the name is unknown.
    """
    if name not in ("auto", *VARIANTS):
        raise ValueError(f"variant: expected auto, cuda or llvm; got {name!r}.")
    find_llvm()
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError as error:
        raise RendererUnavailableError(
            "renderer: the package 'mitsuba' is not installed. "
            "Install it with pip install 'spotlight-relight[training]'."
        ) from error
    if threads is not None:
        dr.set_thread_count(threads)
    failures = []
    for short in ("cuda", "llvm") if name == "auto" else (name,):
        try:
            mi.set_variant(VARIANTS[short])
            if float(dr.sum(mi.Float([1.0, 2.0]))[0]) == 3.0:
                return short
        except (RuntimeError, ImportError, AttributeError) as error:
            failures.append(f"{short}: {str(error).splitlines()[0]}")
    raise RendererUnavailableError(
        f"renderer: no variant works ({'; '.join(failures)}). For the CPU, LLVM is needed. {REMEDY}"
    )


def find_llvm() -> str | None:
    """Point DRJIT_LIBLLVM_PATH at an LLVM that is new enough, where it is not set.

    Return the path, or None.

    An older LLVM that the loader would find by itself aborts the process, so the newest known one
    is named.
    """
    if "DRJIT_LIBLLVM_PATH" in os.environ:
        return os.environ["DRJIT_LIBLLVM_PATH"]
    for version in range(NEWEST_LLVM, OLDEST_LLVM - 1, -1):
        for stem in (f"libLLVM.so.{version}.1", f"libLLVM-{version}.so", f"libLLVM-{version}.so.1"):
            for folder in _FOLDERS:
                path = Path(folder) / stem
                if path.exists():
                    os.environ["DRJIT_LIBLLVM_PATH"] = str(path)
                    return str(path)
        found = ctypes.util.find_library(f"LLVM-{version}")
        if found:
            os.environ["DRJIT_LIBLLVM_PATH"] = found
            return found
    return None
