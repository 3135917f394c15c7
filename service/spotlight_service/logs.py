"""Logs as one JSON object a line, on stderr."""

from __future__ import annotations

import json
import logging
import sys
import time
from typing import Any, Final

__all__ = ["JsonFormatter", "configure_logging"]

_OWN: Final = {*vars(logging.makeLogRecord({})), "message", "asctime", "taskName", "color_message"}
_TOP: Final = "spotlight_service"


class JsonFormatter(logging.Formatter):
    """A record as JSON: time, level, logger, message and whatever was given as ``extra``."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        line: dict[str, Any] = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
            + f".{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        line.update({k: v for k, v in vars(record).items() if k not in _OWN})
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        # In ASCII: characters that break lines elsewhere must not break them here.
        return json.dumps(line, default=str)


def configure_logging(level: int = logging.INFO) -> None:
    """Send this package's and the server's logs to stderr, and what libraries warn of."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    for name in (_TOP, "uvicorn.error"):
        logger = logging.getLogger(name)
        logger.handlers, logger.propagate = [handler], False
        logger.setLevel(level)
