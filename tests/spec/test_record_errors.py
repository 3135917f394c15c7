"""A malformed record is one error that names the path of the offending value."""

import json
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_spec import (
    BACKBONES,
    BackboneSpec,
    FileEntry,
    Manifest,
    MapSpec,
    RecordError,
    ScheduleSpec,
    TensorSpec,
    decode,
    encode,
    read_json,
)

MAP = {"name": "depth", "channels": 1, "minimum": 0.0, "maximum": 1.0}


@dataclass(frozen=True)
class Pair:
    sides: tuple[int, str]
    note: Any = None
    extra: dict[str, int] | None = None


def spoiled(path, value):
    """The OpenRooms backbone as JSON, with the value at ``path`` replaced."""
    document = encode(BACKBONES["zerocomp-openrooms"])
    target = document
    for key in path[:-1]:
        target = target[key]
    target[path[-1]] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        (["size"], "512", r"\$\.size: expected a whole number, got '512'"),
        (["size"], 512.0, r"\$\.size: expected a whole number"),
        (["size"], True, r"\$\.size: expected a whole number, got True"),
        (["size"], None, r"\$\.size"),
        (["noisy_renders"], 1, r"\$\.noisy_renders: expected true or false"),
        (["title"], 5, r"\$\.title: expected text"),
        (["title"], ["x"], r"\$\.title: expected text"),
        (["maps"], {}, r"\$\.maps: expected a list"),
        (["maps"], "depth", r"\$\.maps: expected a list"),
        (["maps", 2], None, r"\$\.maps\[2\]: expected an object describing MapSpec"),
        (["maps", 3, "fill"], "−1", r"\$\.maps\[3\]\.fill: expected a number"),
        (["maps", 0, "name"], "dpeth", r"\$\.maps\[0\]\.name: expected one of 'depth'"),
        (["maps", 0, "name"], ["depth"], r"\$\.maps\[0\]\.name: expected one of"),
        (["maps", 0, "minimum"], False, r"\$\.maps\[0\]\.minimum: expected a number"),
        (["latent"], [], r"\$\.latent: expected an object describing LatentSpec"),
        (["latent", "scaling_factor"], float("inf"), r"\$\.latent\.scaling_factor: .* finite"),
        (["latent", "scaling_factor"], float("nan"), r"\$\.latent\.scaling_factor: .* finite"),
        (["latent", "scaling_factor"], 10**400, r"\$\.latent\.scaling_factor: .* finite"),
        (["schedule", "beta_schedule"], "cosine", r"\$\.schedule\.beta_schedule: expected one of"),
        (["shading", "epsilon"], {}, r"\$\.shading\.epsilon: expected a number"),
    ],
)
def test_wrong_value_names_its_path(path, value, named):
    with pytest.raises(RecordError, match=named):
        decode(BackboneSpec, spoiled(path, value))


def test_unknown_key_is_named_with_the_known_ones():
    with pytest.raises(RecordError, match=r"\$: unknown key 'chanels'; MapSpec has name, channels"):
        decode(MapSpec, MAP | {"chanels": 1})


def test_missing_key_is_named():
    with pytest.raises(RecordError, match=r"\$: missing key 'maximum' of MapSpec"):
        decode(MapSpec, {key: MAP[key] for key in ("name", "channels", "minimum")})


def test_nested_unknown_key_is_named_with_its_path():
    with pytest.raises(RecordError, match=r"manifest\.json\.schedule: unknown key 'step'"):
        decode(BackboneSpec, spoiled(["schedule", "step"], 3), where="manifest.json")


def test_map_named_twice_is_refused_by_path():
    document = spoiled(["maps", 1, "name"], "depth")
    with pytest.raises(RecordError, match=r"\$: .*names a conditioning map twice"):
        decode(BackboneSpec, document)


def test_map_named_twice_is_refused_in_code():
    with pytest.raises(ValueError, match="twice"):
        BackboneSpec("x", "x", (MapSpec("mask", 1, 0, 1), MapSpec("mask", 1, 0, 1)))


@pytest.mark.parametrize("reach", [-0.5, 257.0])
def test_light_that_reaches_beyond_the_picture_is_refused(reach):
    with pytest.raises(RecordError, match=r"\$: .*light_reach from 0 to 256 pixels"):
        decode(BackboneSpec, spoiled(["light_reach"], reach))


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("start_mean", [0.1, 0.2], "start_mean of 4 numbers or of none, got 2"),
        ("start_deviation", -0.1, "start_deviation from 0 to 1, got -0.1"),
        ("start_deviation", 1.5, "start_deviation from 0 to 1, got 1.5"),
    ],
)
def test_a_start_that_is_none_is_refused(field, value, problem):
    with pytest.raises(RecordError, match=rf"\$\.latent: .*{problem}"):
        decode(BackboneSpec, spoiled(["latent", field], value))


def test_fixed_length_list_of_another_length_is_refused():
    assert decode(Pair, {"sides": [1, "a"]}) == Pair((1, "a"))
    with pytest.raises(RecordError, match=r"\$\.sides: expected a list of 2 values"):
        decode(Pair, {"sides": [1]})
    with pytest.raises(RecordError, match=r"\$\.sides\[1\]: expected text"):
        decode(Pair, {"sides": [1, 2]})


def test_anything_is_taken_where_anything_is_meant():
    assert decode(Pair, {"sides": [1, "a"], "note": [None, {}]}).note == [None, {}]


def test_values_of_a_mapping_are_named_by_key():
    with pytest.raises(RecordError, match=r"\$\.extra\.left: expected a whole number"):
        decode(Pair, {"sides": [1, "a"], "extra": {"left": "2"}})
    with pytest.raises(RecordError, match=r"\$\.extra: expected an object"):
        decode(Pair, {"sides": [1, "a"], "extra": [1]})


def test_long_values_are_shortened_in_messages():
    with pytest.raises(RecordError) as caught:
        decode(TensorSpec, "x" * 10_000)
    assert len(str(caught.value)) < 200


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=8,
    )
)
def test_whatever_comes_is_a_record_or_a_record_error(value):
    for kind in (MapSpec, ScheduleSpec, BackboneSpec, Manifest, FileEntry, Pair):
        try:
            record = decode(kind, value)
        except RecordError:
            continue
        assert isinstance(record, kind)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity", '{"a": [1, NaN]}'])
def test_non_json_numbers_are_refused_with_the_file_named(text, tmp_path):
    path = tmp_path / "scene.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=r"scene\.json: -?(NaN|Infinity) is not a JSON number"):
        read_json(path)


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b'{"a": 1}}', b"\xff\xfe{}", b'"\xe9"', b"[" * 200_000, b"1" * 10_000, b"{'a': 1}"],
    ids=["empty", "open", "trailing", "utf16", "latin1", "deep", "huge int", "quotes"],
)
def test_what_is_no_json_names_the_file(data, tmp_path):
    path = tmp_path / "scene.json"
    path.write_bytes(data)
    with pytest.raises(RecordError, match=r"scene\.json: expected a UTF-8 JSON document"):
        read_json(path)


def test_overflowing_number_in_a_file_is_not_infinity(tmp_path):
    path = tmp_path / "latent.json"
    path.write_text(json.dumps(MAP).replace("1.0", "1e999"))
    with pytest.raises(RecordError, match=r"\.maximum: expected a finite number"):
        decode(MapSpec, read_json(path), where=str(path))


def test_record_errors_are_value_errors():
    assert issubclass(RecordError, ValueError)


def test_key_given_twice_is_refused(tmp_path):
    path = tmp_path / "scene.json"
    path.write_text('{"a": 1, "b": {"c": 1, "c": 2}}', encoding="utf-8")
    with pytest.raises(RecordError, match=r"scene\.json: key 'c' is given twice"):
        read_json(path)
