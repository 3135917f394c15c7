"""Seeded noise: one stream a purpose, the same bytes every time."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_runtime.diffusion.noise import MAX_SEED, gaussian
from spotlight_runtime.errors import InvalidInputError

SHAPE = (1, 4, 8, 8)
STREAMS = ["initial", "posterior", "step"]
SEEDS = st.integers(0, MAX_SEED)


@given(SEEDS, st.sampled_from(STREAMS), st.integers(0, 1000))
def test_same_seed_same_bytes(seed, stream, index):
    first = gaussian(seed, stream, SHAPE, index)
    assert first.tobytes() == gaussian(seed, stream, SHAPE, index).tobytes()
    assert first.dtype == np.float32
    assert first.shape == SHAPE


@given(
    st.lists(
        st.tuples(
            st.sampled_from([0, 1, 2, 5, 2**32, 2**32 + 5, 2**33, 2**33 + 5, MAX_SEED]) | SEEDS,
            st.sampled_from(STREAMS),
            st.integers(0, 3),
        ),
        min_size=2,
        max_size=8,
        unique=True,
    )
)
def test_streams_of_all_seeds_are_different(keys):
    arrays = [gaussian(seed, stream, (16,), index).tobytes() for seed, stream, index in keys]
    assert len(set(arrays)) == len(keys)


def test_a_large_seed_does_not_run_into_another_stream():
    """2**32 + 5 is (5, 1) in 32-bit words: it must not be mistaken for stream 1 of seed 5."""
    assert not np.array_equal(
        gaussian(2**32 + 5, "initial", SHAPE), gaussian(5, "posterior", SHAPE)
    )


def test_streams_are_uncorrelated():
    n = 100_000
    streams = [gaussian(469, s, (n,), i) for s in STREAMS for i in range(2)]
    correlation = np.corrcoef(streams) - np.eye(len(streams))
    assert np.abs(correlation).max() < 5 / np.sqrt(n)


def test_it_is_unit_gaussian():
    noise = gaussian(0, "initial", (200_000,)).astype(np.float64)
    assert noise.mean() == pytest.approx(0.0, abs=0.01)
    assert noise.std() == pytest.approx(1.0, abs=0.01)
    assert (np.abs(noise) < 1.0).mean() == pytest.approx(0.6827, abs=0.005)


def test_one_stream_is_a_prefix_of_itself():
    """A plan that needs more of a stream does not change what came before."""
    np.testing.assert_array_equal(
        gaussian(1, "step", (4, 8)).ravel(), gaussian(1, "step", (8, 8)).ravel()[:32]
    )


@pytest.mark.parametrize("seed", [0, MAX_SEED, np.int64(3), np.uint64(3)])
def test_both_ends_and_numpy_integers_are_seeds(seed):
    assert np.isfinite(gaussian(seed, "initial", SHAPE)).all()
    assert (
        gaussian(seed, "initial", (4,)).tobytes() == gaussian(int(seed), "initial", (4,)).tobytes()
    )


@pytest.mark.parametrize("seed", [-1, MAX_SEED + 1, 1.0, "1", None, True, np.float64(3), [1]])
def test_other_seeds_are_refused(seed):
    with pytest.raises(InvalidInputError, match=r"seed: expected a whole number from 0 to 2\*\*63"):
        gaussian(seed, "initial", SHAPE)


def test_global_randomness_is_not_touched():
    np.random.seed(3)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    gaussian(1, "initial", SHAPE)
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_the_bytes_of_the_default_seed_are_pinned():
    """A change here changes every picture ever made: it wants a line in the changelog."""
    noise = gaussian(469, "initial", (4, 8, 8))
    assert hashlib.sha256(noise.tobytes()).hexdigest()[:16] == "0f22c2b68f51eda3"
