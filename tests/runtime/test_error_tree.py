"""One class a cause, each also the builtin a caller would expect, as the docstring draws it."""

import inspect

import pytest

from spotlight_runtime import errors

BUILTINS = {
    "InvalidInputError": ValueError,
    "ShapeError": ValueError,
    "NonFiniteError": ValueError,
    "BudgetError": ValueError,
    "GroundError": ValueError,
    "LightError": ValueError,
    "DtypeError": TypeError,
    "MissingMapError": LookupError,
    "ImageFileError": OSError,
    "SceneError": ValueError,
    "UnsafePathError": ValueError,
    "ProductError": ValueError,
    "PlacementError": ValueError,
    "ModelError": RuntimeError,
    "UnknownModelError": LookupError,
    "ModelIntegrityError": RuntimeError,
    "GraphContractError": RuntimeError,
    "ProviderError": RuntimeError,
    "NumericalError": ArithmeticError,
    "MissingExtraError": ImportError,
}


@pytest.mark.parametrize(("name", "builtin"), BUILTINS.items())
def test_class_is_of_the_tree_and_of_its_builtin(name, builtin):
    kind = getattr(errors, name)
    assert issubclass(kind, errors.SpotLightError)
    assert issubclass(kind, builtin)
    assert str(kind("depth: expected this, got that")) == "depth: expected this, got that"


def test_nothing_is_left_out():
    defined = {n for n, c in vars(errors).items() if inspect.isclass(c)}
    assert defined == {"SpotLightError", "ShadowWarning", *BUILTINS} == set(errors.__all__)
    assert all(name in errors.__doc__ for name in defined)
