"""Frozen dataclasses to and from JSON, strictly.

Every file SpotLight reads back (a model's ``manifest.json``, a scene's ``scene.json``) is one
frozen dataclass tree. This module is the single place that turns JSON into such a tree: unknown
keys, missing keys and wrong types are errors that name the path of the offending value, so a typo
in a hand-written file never becomes a silent default.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from spotlight_spec.files import replacing

__all__ = ["RecordError", "decode", "encode", "read_json", "write_json"]

T = TypeVar("T")


class RecordError(ValueError):
    """A JSON value does not match the record it should describe.

    The message names the path inside the document, what was expected and what came.
    """


def encode(record: Any) -> Any:
    """Turn a dataclass tree into plain JSON values (tuples become lists)."""
    return json.loads(json.dumps(dataclasses.asdict(record), allow_nan=False))


def decode(kind: type[T], value: Any, where: str = "$") -> T:
    """Build ``kind`` from parsed JSON.

    Parameters
    ----------
    kind : type
        A dataclass, a builtin scalar, ``tuple[X, ...]``, ``dict[str, X]``, ``Literal`` or a union.
    value : Any
        What ``json.loads`` returned.
    where : str
        Path of ``value`` in the document, for messages.

    Raises
    ------
    RecordError
        If a key is unknown or missing, or a value has the wrong type or is not finite.
    """
    return _decode(kind, value, where)


def read_json(path: Path) -> Any:
    """Parse a UTF-8 JSON file; NaN, Infinity and a key given twice are refused.

    Raises
    ------
    RecordError
        If the file is not UTF-8 JSON.
    """

    def refuse(name: str) -> Any:
        raise RecordError(f"{path}: {name} is not a JSON number; write a finite value")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in pairs:  # counting each key among all takes hours of a hostile file
            if key in found:
                raise RecordError(f"{path}: key {key!r} is given twice; keep one of them")
            found[key] = value
        return found

    try:
        text = path.read_text(encoding="utf-8")
        return json.loads(text, parse_constant=refuse, object_pairs_hook=unique)
    except RecordError:
        raise
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path}: expected a UTF-8 JSON document, got {error}") from error


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as indented JSON by write-then-rename: readers never see half a file."""
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _decode(kind: Any, value: Any, where: str) -> Any:
    origin = get_origin(kind)
    if dataclasses.is_dataclass(kind):
        return _decode_dataclass(kind, value, where)
    if kind is Any:
        return value
    if origin is Literal:
        options = get_args(kind)
        if value not in options or isinstance(value, bool):
            raise _mismatch(where, f"one of {', '.join(map(repr, options))}", value)
        return value
    if origin in (Union, types.UnionType):
        return _decode_optional(kind, value, where)
    if origin is tuple:
        return _decode_tuple(kind, value, where)
    if origin is dict:
        if not isinstance(value, dict):
            raise _mismatch(where, "an object", value)
        item = get_args(kind)[1]
        return {key: _decode(item, entry, f"{where}.{key}") for key, entry in value.items()}
    return _decode_scalar(kind, value, where)


def _decode_dataclass(kind: Any, value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise _mismatch(where, f"an object describing {kind.__name__}", value)
    fields = {field.name: field for field in dataclasses.fields(kind)}
    unknown = sorted(set(value) - set(fields))
    if unknown:
        known = ", ".join(fields)
        raise RecordError(f"{where}: unknown key {unknown[0]!r}; {kind.__name__} has {known}")
    hints = get_type_hints(kind)
    arguments = {}
    for name, field in fields.items():
        if name in value:
            arguments[name] = _decode(hints[name], value[name], f"{where}.{name}")
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise RecordError(f"{where}: missing key {name!r} of {kind.__name__}")
    try:
        return kind(**arguments)
    except RecordError:
        raise
    except ValueError as error:  # a record may check itself in __post_init__
        raise RecordError(f"{where}: {error}") from error


def _decode_optional(kind: Any, value: Any, where: str) -> Any:
    options = get_args(kind)
    if value is None and type(None) in options:
        return None
    failures = []
    for option in options:
        if option is type(None):
            continue
        try:
            return _decode(option, value, where)
        except RecordError as error:
            failures.append(error)
    raise failures[0]


def _decode_tuple(kind: Any, value: Any, where: str) -> Any:
    if not isinstance(value, list):
        raise _mismatch(where, "a list", value)
    items = get_args(kind)
    if len(items) == 2 and items[1] is Ellipsis:
        return tuple(_decode(items[0], v, f"{where}[{i}]") for i, v in enumerate(value))
    if len(items) != len(value):
        raise _mismatch(where, f"a list of {len(items)} values", value)
    return tuple(_decode(item, v, f"{where}[{i}]") for i, (item, v) in enumerate(zip(items, value)))


def _decode_scalar(kind: Any, value: Any, where: str) -> Any:
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # a whole number beyond the float range
            number = math.inf
        if not math.isfinite(number):
            raise _mismatch(where, "a finite number", value)
        return number
    if kind is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind in (str, bool) and isinstance(value, kind):
        return value
    names = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}
    raise _mismatch(where, names.get(kind, str(kind)), value)


def _mismatch(where: str, expected: str, value: Any) -> RecordError:
    try:
        shown = repr(value)
    except RecursionError:  # nested just less deep than the parser allows
        shown = f"a {type(value).__name__} nested too deep"
    if len(shown) > 60:
        shown = shown[:57] + "..."
    return RecordError(f"{where}: expected {expected}, got {shown}")
