"""Bootstrap intervals: determinism, and cases with a known answer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_bench.statistics import by_scene, difference, estimate

VALUES = {f"room_{i}": float(v) for i, v in enumerate([3, 1, 4, 1, 5, 9, 2, 6])}


def test_the_same_seed_gives_the_same_interval_whatever_the_order():
    turned = dict(reversed(VALUES.items()))
    assert estimate(VALUES) == estimate(turned)
    assert estimate(VALUES, seed=1) == estimate(turned, seed=1)
    assert estimate(VALUES, seed=1) != estimate(VALUES, seed=2)


def test_two_scenes_have_three_possible_means():
    """Half of the resamples draw both scenes, a quarter each draws one of them twice."""
    found = estimate({"a": 0.0, "b": 1.0})
    assert (found.mean, found.low, found.high, found.scenes) == (0.5, 0.0, 1.0, 2)


def test_many_scenes_come_near_the_normal_interval():
    values = {str(i): float(i % 2) for i in range(400)}
    found = estimate(values)
    half = 1.96 * 0.5 / 400**0.5
    assert found.low == pytest.approx(0.5 - half, abs=0.006)
    assert found.high == pytest.approx(0.5 + half, abs=0.006)


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=20))
def test_the_interval_holds_the_mean_and_stays_within_the_values(values):
    found = estimate({str(i): v for i, v in enumerate(values)}, resamples=200)
    tolerance = 1e-9 * (1 + max(map(abs, values)))
    assert min(values) - tolerance <= found.low <= found.high <= max(values) + tolerance
    assert found.mean == pytest.approx(sum(values) / len(values), abs=1e-9)


def test_one_scene_has_no_width_and_none_has_no_estimate():
    found = estimate({"a": 2.5})
    assert (found.low, found.mean, found.high) == (2.5, 2.5, 2.5)
    assert estimate({}) is None


def test_directions_are_averaged_within_their_scene_first():
    values = [("a", 1.0), ("a", 3.0), ("b", 10.0), ("b", None), ("c", None)]
    assert by_scene(values) == {"a": 2.0, "b": 10.0}


def test_a_paired_difference_is_not_blurred_by_how_scenes_differ():
    better = {scene: value + 0.5 for scene, value in VALUES.items()}
    found = difference({**better, "extra": 100.0}, VALUES)
    assert found.scenes == len(VALUES)
    assert (found.low, found.mean, found.high) == pytest.approx((0.5, 0.5, 0.5))
    assert difference({"x": 1.0}, {"y": 1.0}) is None
