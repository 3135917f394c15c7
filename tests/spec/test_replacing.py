"""Write-then-rename."""

import stat
from concurrent.futures import ThreadPoolExecutor

import pytest

from spotlight_spec import replacing


def test_file_appears_whole(tmp_path):
    path = tmp_path / "a.txt"
    with replacing(path) as partial:
        partial.write_text("whole")
        assert not path.exists()
        assert partial.parent == tmp_path
    assert path.read_text() == "whole"
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_failure_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail():
        with replacing(path) as partial:
            partial.write_text("half")
            raise error

    with pytest.raises(error):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_writers_at_once_do_not_mix(tmp_path):
    path = tmp_path / "a.txt"

    def write(letter):
        with replacing(path) as partial:
            partial.write_text(letter * 100_000)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, "abcdefgh"))
    assert len(set(path.read_text())) == 1
    assert list(tmp_path.iterdir()) == [path]
