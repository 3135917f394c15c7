"""Keep what libraries say about themselves off the console; errors still come through."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

__all__ = ["quiet_libraries"]

LIBRARIES: Final = ("diffusers", "transformers", "torch.onnx", "onnxscript", "root")


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Silence progress bars, remarks and deprecations of the libraries used to load and trace."""
    import diffusers.utils.logging
    import transformers.utils.logging

    bars = (diffusers.utils.logging, transformers.utils.logging)
    enabled = [bar.is_progress_bar_enabled() for bar in bars]
    loggers = [logging.getLogger(None if name == "root" else name) for name in LIBRARIES]
    levels = [logger.level for logger in loggers]
    for bar in bars:
        bar.disable_progress_bar()
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels):
            logger.setLevel(level)
        for bar, was_enabled in zip(bars, enabled):
            if was_enabled:
                bar.enable_progress_bar()
