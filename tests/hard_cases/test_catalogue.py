"""Every hard case agrees with the oracle, or ends in the error that is documented for it."""

from __future__ import annotations

from itertools import chain

import pytest

from . import (
    estimator_cases,
    latent_cases,
    loop_cases,
    map_cases,
    picture_cases,
    precision_cases,
    relight_cases,
)
from .case import Case, Refusal, compare

REGISTRIES = (
    loop_cases,
    latent_cases,
    map_cases,
    picture_cases,
    precision_cases,
    estimator_cases,
    relight_cases,
)
CASES: list[Case] = list(chain.from_iterable(module.CASES for module in REGISTRIES))
REFUSALS: list[Refusal] = list(
    chain.from_iterable(getattr(module, "REFUSALS", ()) for module in REGISTRIES)
)


def params(cases):
    return [
        pytest.param(
            case, id=case.name, marks=[pytest.mark.full] if getattr(case, "full", False) else []
        )
        for case in cases
    ]


@pytest.mark.parametrize("case", params(CASES))
def test_case_agrees_with_the_oracle(case: Case) -> None:
    error = compare(case)
    assert error <= 1.0, f"{case.why}: {error:.2g} times its tolerance"


@pytest.mark.parametrize("case", params(REFUSALS))
def test_case_ends_in_its_documented_error(case: Refusal) -> None:
    with pytest.raises(case.error, match=case.message):
        case.act()


def test_cases_have_names_of_their_own_and_reasons() -> None:
    names = [case.name for case in chain(CASES, REFUSALS)]
    assert len(set(names)) == len(names)
    assert all(case.why for case in chain(CASES, REFUSALS))
