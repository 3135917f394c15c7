"""Results on disk: what comes back, and what a stopped or a foreign run leaves."""

from dataclasses import replace

import pytest

from spotlight_bench.errors import ResultsError
from spotlight_bench.results import Result, ResultStore

SETTINGS = {"model": "tiny", "steps": 2, "seed": 469}
RESULT = Result(
    scene="room_0",
    direction="0000",
    method="spotlight",
    how="spotlight gamma=3",
    scores={"full": {"psnr": 30.5, "st_lpips": None}, "foreground": {"psnr": 20.25}},
    following=(0.5, 0.25),
    following_offset_free=(0.125, 1.5),
    background_change=0.001,
    evaluations=4,
    seconds=1.5,
)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "results.jsonl"
    store = ResultStore(path, SETTINGS)
    store.add([RESULT])
    store.add([replace(RESULT, direction="0001"), replace(RESULT, direction="0002")])
    return path


def test_a_resumed_run_has_what_was_stored(path):
    store = ResultStore(path, SETTINGS, resume=True)
    assert [r.direction for r in store] == ["0000", "0001", "0002"]
    assert next(iter(store)) == RESULT
    assert store.has("room_0", "0001", "spotlight", "spotlight gamma=3")
    assert not store.has("room_0", "0001", "spotlight", "spotlight gamma=7")
    assert not store.has("room_1", "0001", "spotlight", "spotlight gamma=3")


def test_a_picture_made_anew_takes_the_place_of_the_old(path):
    ResultStore(path, SETTINGS, resume=True).add([replace(RESULT, how="changed")])
    store = ResultStore(path, SETTINGS, resume=True)
    assert len(store) == 3
    assert store.has("room_0", "0000", "spotlight", "changed")


def test_a_line_cut_short_is_made_again(path):
    text = path.read_text()
    path.write_text(text[:-20])
    store = ResultStore(path, SETTINGS, resume=True)
    assert [r.direction for r in store] == ["0000", "0001"]
    store.add([replace(RESULT, direction="0002")])
    assert len(ResultStore(path, SETTINGS, resume=True)) == 3


def test_results_are_not_overwritten_unasked(path):
    with pytest.raises(ResultsError, match="--resume"):
        ResultStore(path, SETTINGS)


def test_results_of_another_run_are_refused(path):
    with pytest.raises(ResultsError, match="steps 2, now 20"):
        ResultStore(path, {**SETTINGS, "steps": 20}, resume=True)
    assert len(ResultStore(path, SETTINGS, resume=True)) == 3


@pytest.mark.parametrize("damage", ['{"scene": 1}', "{", '{"settings": {}}', "[]"])
def test_a_damaged_line_is_named(path, damage):
    lines = path.read_text().splitlines()
    lines[2] = damage
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ResultsError, match="line 3 is damaged"):
        ResultStore(path, SETTINGS, resume=True)


def test_a_file_that_is_no_results_is_named(tmp_path):
    path = tmp_path / "results.jsonl"
    path.write_text('{"hello": 1}\n')
    with pytest.raises(ResultsError, match="line 1 is damaged"):
        ResultStore(path, SETTINGS, resume=True)
