"""Write-then-rename."""

import os
import stat
from concurrent.futures import ThreadPoolExecutor

import pytest

from spotlight_spec import replacing


@pytest.fixture
def umask():
    """Set the process's umask; it is as before afterwards."""
    before = os.umask(0)
    os.umask(before)
    yield os.umask
    os.umask(before)


@pytest.mark.parametrize(("masked", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_file_appears_whole(tmp_path, umask, masked, mode):
    umask(masked)
    path = tmp_path / "a.txt"
    with replacing(path) as partial:
        partial.write_text("whole")
        assert not path.exists()
        assert partial.parent == tmp_path
    assert path.read_text() == "whole"
    assert stat.S_IMODE(path.stat().st_mode) == mode


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


@pytest.mark.parametrize("there", [True, False])
def test_a_link_leads_to_what_is_replaced(tmp_path, there):
    far, link = tmp_path / "far", tmp_path / "link.txt"
    far.mkdir()
    if there:
        (far / "a.txt").write_text("old")
    link.symlink_to("far/a.txt")
    with replacing(link, keep_suffix=True) as partial:
        partial.write_text("new")
        assert partial.parent == far
        assert partial.suffix == ".txt"
    assert link.is_symlink()
    assert (far / "a.txt").read_text() == "new"
    assert list(far.iterdir()) == [far / "a.txt"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_written_to_and_stays(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with replacing(pipe) as partial:
            partial.write_text("through")
        assert os.read(reading, 100) == b"through"
    finally:
        os.close(reading)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]


def test_errors_name_what_the_caller_knows(tmp_path):
    path = tmp_path / "nowhere/a.txt"
    with pytest.raises(FileNotFoundError) as caught, replacing(path):
        pass
    assert caught.value.filename == str(path)
