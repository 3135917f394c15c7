"""Everything that can go wrong, one class a cause.

Each message names the input, what was expected, what came and the remedy. Every class also derives
from the builtin a caller would expect, so ``except ValueError`` works too.

::

    SpotLightError
    ├── InvalidInputError (ValueError)       an array or option is out of its domain
    │   ├── ShapeError                       wrong size or number of channels
    │   ├── NonFiniteError                   NaN or infinity in an input
    │   ├── GroundError                      no floor where one is needed
    │   └── LightError                       a light below the floor, or in the object
    ├── DtypeError (TypeError)               an array of the wrong element type
    ├── MissingMapError (LookupError)        the scene lacks a map the backbone needs
    ├── ImageFileError (OSError)             an image that cannot be read or written
    ├── SceneError (ValueError)              a scene bundle that is not one
    │   └── UnsafePathError                  a path that leaves the bundle
    ├── ModelError (RuntimeError)
    │   ├── UnknownModelError (LookupError)  no such model here
    │   ├── ModelIntegrityError              files that do not match the manifest
    │   ├── GraphContractError               a graph that does not match its contract
    │   └── ProviderError                    the execution provider asked for is not in use
    ├── NumericalError (ArithmeticError)     NaN or infinity arose; names the stage and the step
    └── MissingExtraError (ImportError)      an optional package is not installed
"""

from __future__ import annotations

__all__ = [
    "DtypeError",
    "GraphContractError",
    "GroundError",
    "ImageFileError",
    "InvalidInputError",
    "LightError",
    "MissingExtraError",
    "MissingMapError",
    "ModelError",
    "ModelIntegrityError",
    "NonFiniteError",
    "NumericalError",
    "ProviderError",
    "SceneError",
    "ShapeError",
    "SpotLightError",
    "UnknownModelError",
    "UnsafePathError",
]


class SpotLightError(Exception):
    """Base of every error this package raises on purpose."""


class InvalidInputError(SpotLightError, ValueError):
    """An array or option is outside its domain."""


class ShapeError(InvalidInputError):
    """An array has the wrong size or number of channels."""


class NonFiniteError(InvalidInputError):
    """An input holds NaN or infinity."""


class GroundError(InvalidInputError):
    """There is no floor where one is needed."""


class LightError(InvalidInputError):
    """A light stands where none can be: below the floor, or in the object."""


class DtypeError(SpotLightError, TypeError):
    """An array has the wrong element type."""


class MissingMapError(SpotLightError, LookupError):
    """The scene lacks a map that the backbone needs."""


class ImageFileError(SpotLightError, OSError):
    """An image file cannot be read or written."""


class SceneError(SpotLightError, ValueError):
    """A scene bundle is malformed."""


class UnsafePathError(SceneError):
    """A file named by a scene lies outside its bundle."""


class ModelError(SpotLightError, RuntimeError):
    """A model folder cannot be used."""


class UnknownModelError(ModelError, LookupError):
    """No model of that name or at that path."""


class ModelIntegrityError(ModelError):
    """The files of a model folder do not match its manifest."""


class GraphContractError(ModelError):
    """An ONNX graph does not match the contract its manifest states."""


class ProviderError(ModelError):
    """The execution provider asked for is not the one in use."""


class NumericalError(SpotLightError, ArithmeticError):
    """NaN or infinity arose during the computation."""


class MissingExtraError(SpotLightError, ImportError):
    """An optional dependency is not installed; the message names the pip command."""
