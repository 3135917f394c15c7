"""What is written is what is read, for every record type."""

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spec.record_strategies import FINITE, records
from spotlight_spec import (
    BACKBONES,
    BackboneSpec,
    FileEntry,
    GraphContract,
    LatentSpec,
    Manifest,
    MapSpec,
    ParityRow,
    ScheduleSpec,
    ShadingSpec,
    Source,
    TensorSpec,
    decode,
    encode,
    read_json,
    write_json,
)

KINDS = [
    BackboneSpec,
    FileEntry,
    GraphContract,
    LatentSpec,
    Manifest,
    MapSpec,
    ParityRow,
    ScheduleSpec,
    ShadingSpec,
    Source,
    TensorSpec,
]


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15)
@given(data=st.data())
def test_every_record_survives_json_text(kind, data):
    record = data.draw(records(kind))
    assert decode(kind, json.loads(json.dumps(encode(record)))) == record


@given(number=FINITE)
def test_every_finite_number_survives(number):
    entry = MapSpec("depth", 1, number, number)
    assert decode(MapSpec, encode(entry)) == entry


@pytest.mark.parametrize("number", [1.7976931348623157e308, -1.7976931348623157e308, 5e-324])
def test_the_ends_of_the_float_range_are_finite_numbers(number):
    assert decode(float, number) == number


def test_negative_zero_keeps_its_sign():
    entry = MapSpec("depth", 1, -0.0, 1.0)
    assert math.copysign(1.0, decode(MapSpec, encode(entry)).minimum) == -1.0


def test_a_whole_number_is_a_number_and_becomes_a_float():
    value = decode(float, 3)
    assert value == 3.0
    assert isinstance(value, float)


@pytest.mark.parametrize("spec", BACKBONES.values(), ids=BACKBONES)
def test_catalogue_survives_a_file(spec, tmp_path):
    path = tmp_path / "spec.json"
    write_json(path, encode(spec))
    assert decode(BackboneSpec, read_json(path), where=str(path)) == spec


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_what_json_cannot_hold_is_not_written(number):
    with pytest.raises(ValueError, match="JSON"):
        encode(MapSpec("depth", 1, 0.0, number))


def test_missing_fields_take_their_documented_defaults():
    assert decode(ScheduleSpec, {}) == ScheduleSpec()
    assert decode(LatentSpec, {"channels": 8}) == LatentSpec(channels=8)
