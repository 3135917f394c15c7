"""Everything that can go wrong, one class a cause.

Each message names the input, what was expected, what came and the remedy. Every class also derives
from the builtin a caller would expect, so ``except ValueError`` works too.

::

    SpotLightError
    ├── InvalidInputError (ValueError)       an array or option is out of its domain
    │   ├── ShapeError                       wrong size or number of channels
    │   ├── NonFiniteError                   NaN or infinity in an input
    │   ├── BudgetError                      fewer seconds than any plan takes
    │   ├── GroundError                      no floor where one is needed
    │   └── LightError                       a light below the floor, or in the object
    ├── DtypeError (TypeError)               an array of the wrong element type
    ├── MissingMapError (LookupError)        the scene lacks a map the backbone needs
    ├── ImageFileError (OSError)             an image that cannot be read or written
    ├── SceneError (ValueError)              a scene bundle that is not one
    │   └── UnsafePathError                  a path that leaves the folder of the file naming it
    ├── ProductError (ValueError)            a 3-D model or cut-out that cannot be used
    ├── PlacementError (ValueError)          an object that cannot be put where it was asked
    ├── ModelError (RuntimeError)
    │   ├── UnknownModelError (LookupError)  no such model here
    │   ├── ModelIntegrityError              files that do not match the manifest
    │   ├── GraphContractError               a graph that does not match its contract
    │   └── ProviderError                    the execution provider asked for is not in use
    ├── NumericalError (ArithmeticError)     NaN or infinity arose; names the stage and the step
    └── MissingExtraError (ImportError)      an optional package is not installed

``ShadowWarning`` (UserWarning) is no error: it says that next to nothing of a shadow is seen.
"""

from __future__ import annotations

__all__ = [
    "BudgetError",
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
    "PlacementError",
    "ProductError",
    "ProviderError",
    "SceneError",
    "ShadowWarning",
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


class BudgetError(InvalidInputError):
    """Fewer seconds than any plan takes."""


class GroundError(InvalidInputError):
    """There is no floor where one is needed."""


class LightError(InvalidInputError):
    """A light stands where none can be: below the floor, or in the object."""


class ShadowWarning(UserWarning):
    """Next to nothing of a shadow is seen, or none serves as the negative; it says why."""


class DtypeError(SpotLightError, TypeError):
    """An array has the wrong element type."""


class MissingMapError(SpotLightError, LookupError):
    """The scene lacks a map that the backbone needs."""


class ImageFileError(SpotLightError, OSError):
    """An image file cannot be read or written."""


class SceneError(SpotLightError, ValueError):
    """A scene bundle is malformed."""


class UnsafePathError(SceneError):
    """A file named by a scene, a model or a list of lights lies outside its folder."""


class ProductError(SpotLightError, ValueError):
    """A 3-D model or a cut-out cannot be used as the object."""


class PlacementError(SpotLightError, ValueError):
    """The object cannot be put where it was asked: out of the frame, behind the camera, hidden."""


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
