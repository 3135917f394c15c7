"""Errors of the exporter, one class a cause.

::

    ExportError
    ├── CheckpointError (also ValueError)
    │   ├── MissingWeightsError (also FileNotFoundError)
    │   ├── ConditioningChannelsError
    │   ├── FingerprintError
    │   └── UnsupportedArchitectureError
    ├── ModelFolderError (also ValueError)
    ├── OutputFolderError (also FileExistsError)
    ├── TraceError (also RuntimeError)
    ├── QuantisationError (also RuntimeError)
    └── VerificationError (also ValueError)

Every message names the input, what was expected, what came and the remedy.
"""

from __future__ import annotations

__all__ = [
    "CheckpointError",
    "ConditioningChannelsError",
    "ExportError",
    "FingerprintError",
    "MissingWeightsError",
    "ModelFolderError",
    "OutputFolderError",
    "QuantisationError",
    "TraceError",
    "UnsupportedArchitectureError",
    "VerificationError",
]


class ExportError(Exception):
    """Something the exporter can explain."""


class CheckpointError(ExportError, ValueError):
    """A checkpoint cannot be read as what it was given for."""


class MissingWeightsError(CheckpointError, FileNotFoundError):
    """A folder, file or tensor of the checkpoint is not there."""


class ConditioningChannelsError(CheckpointError):
    """The ControlNet was trained for other conditioning maps than the backbone's."""


class FingerprintError(CheckpointError):
    """The weights differ from those a model was exported from."""


class UnsupportedArchitectureError(CheckpointError):
    """The checkpoint uses a variant whose arithmetic this exporter does not reproduce."""


class ModelFolderError(ExportError, ValueError):
    """A folder is not a model, or not the model its manifest describes."""


class OutputFolderError(ExportError, FileExistsError):
    """The output folder holds something that must not be overwritten."""


class TraceError(ExportError, RuntimeError):
    """A network could not be turned into a graph."""


class QuantisationError(ExportError, RuntimeError):
    """A graph could not be quantised."""


class VerificationError(ExportError, ValueError):
    """A model cannot be verified; a model that is merely inexact is a result, not an error."""
