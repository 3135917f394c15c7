"""Hypothesis strategies for any record, read off its type hints as the decoder reads them."""

from __future__ import annotations

import dataclasses
import types
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

from spotlight_spec import BackboneSpec, FileEntry, LatentSpec, Manifest

FINITE = st.floats(allow_nan=False, allow_infinity=False)
SCALARS = {float: FINITE, int: st.integers(), str: st.text(max_size=20), bool: st.booleans()}


def records(kind: Any) -> st.SearchStrategy[Any]:
    """Valid values of a record type."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind in SCALARS:
        return SCALARS[kind]
    if kind is type(None):
        return st.none()
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin in (Union, types.UnionType):
        return st.one_of(*map(records, arguments))
    if origin is tuple:
        unique = {"unique_by": lambda entry: entry.name} if _named(arguments[0]) else {}
        return st.lists(records(arguments[0]), max_size=3, **unique).map(tuple)
    if origin is dict:
        return st.dictionaries(st.text(max_size=8), records(arguments[1]), max_size=3)
    hints = get_type_hints(kind)
    fields = {name: records(hint) for name, hint in hints.items()}
    fields |= {
        FileEntry: {"path": st.from_regex(r"[a-z]{1,8}(/[a-z]{1,8})?\.onnx", fullmatch=True)},
        Manifest: {"format": st.just(1)},
        BackboneSpec: {"light_reach": st.floats(0.0, 256.0)},
        LatentSpec: {"start_mean": st.just(()), "start_deviation": st.floats(0.0, 1.0)},
    }.get(kind, {})
    return st.builds(kind, **fields)


def _named(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind) and "name" in {f.name for f in dataclasses.fields(kind)}
