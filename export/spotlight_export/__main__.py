"""Entry point of ``spotlight-export``: complain in one line, or run."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from typing import Final

__all__ = ["main"]

EXTRAS: Final = ("torch", "diffusers", "transformers", "onnx", "onnx_ir", "onnxscript")


def main() -> None:
    """Run the command line; errors of the package are one line on stderr and exit code 1."""
    if missing := [name for name in EXTRAS if find_spec(name) is None]:
        sys.exit(
            f"spotlight-export: {', '.join(missing)} missing; "
            "pip install 'spotlight-relight[export]'"
        )
    from spotlight_export.cli import app
    from spotlight_export.errors import ExportError

    try:
        app()
    except ExportError as error:
        sys.exit(f"spotlight-export: {error}")


if __name__ == "__main__":
    main()
