"""Signal 9 at any moment: nothing half-written is taken for whole, and the next run succeeds."""

import signal
import subprocess
import sys

import pytest

from faults.processes import environment, python, spotlight
from spotlight_runtime import Scene, read_image

NAMES = ["png", "jpg", "exr", "record", "scene", "costs", "film"]


@pytest.mark.skipif(sys.platform != "linux", reason="forks, and counts what Linux does")
def test_killed_at_every_step_on_the_file_system(tmp_path):
    pytest.importorskip("PIL", reason="films need the extra scene")
    done = subprocess.run(
        [sys.executable, "-m", "faults.crashes", str(tmp_path), *NAMES],
        capture_output=True,
        text=True,
        env=environment(),
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    steps = dict(line.split() for line in done.stdout.splitlines())
    assert list(steps) == NAMES
    assert all(int(count) >= 3 for count in steps.values()), steps
    assert int(steps["scene"]) > 40, "every map has its steps"


RELIGHT = """
    import sys
    from spotlight_runtime import Relighter, Scene, read_image, write_image
    place, model, out, slow = sys.argv[1:]
    relighter = Relighter.load(model, threads=1)
    run = relighter.run(Scene.load(place + "/scene"), read_image(place + "/shadow.png"))
    while True:
        try:
            progress = next(run)
        except StopIteration as stop:
            write_image(out, stop.value.image)
            break
        print(progress.stage, progress.step.index, flush=True)
        if slow == "wait" and progress.step.index == 1:
            sys.stdin.readline()
"""


def test_killed_in_mid_relight(place, backbone, tmp_path):
    """The picture of before is still there, and the next run makes what an undisturbed one does."""
    import textwrap

    out = tmp_path / "out.png"
    out.write_bytes((place / "shadow.png").read_bytes())
    before = out.read_bytes()
    command = [sys.executable, "-c", textwrap.dedent(RELIGHT), place, backbone, out, "wait"]
    with subprocess.Popen(
        list(map(str, command)),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment(),
    ) as process:
        assert [process.stdout.readline() for _ in range(2)][-1] == "relight 1\n"
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == ["out.png"]
    assert out.read_bytes() == before
    done = python(RELIGHT, place, backbone, out, "on")
    assert done.returncode == 0, done.stderr
    again = tmp_path / "again.png"
    assert python(RELIGHT, place, backbone, again, "on").returncode == 0
    assert out.read_bytes() == again.read_bytes()


def test_command_line_killed_leaves_nothing_to_trip_over(asked, tmp_path):
    """Stopped as it opens the file it would rename: a leftover beside the picture, no picture."""
    script = """
        import os, signal, sys
        def stop(event, arguments):
            if event == "os.rename":
                os.kill(os.getpid(), signal.SIGKILL)
        sys.addaudithook(stop)
        from spotlight_runtime.cli import main
        main()
    """
    out = tmp_path / "out.png"
    done = python(script, *asked, "-o", out)
    assert done.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".out.png.")
    assert left.name.endswith(".partial")
    again = subprocess.run(
        spotlight(*asked, "-o", out), capture_output=True, text=True, env=environment(), check=False
    )
    assert again.returncode == 0, again.stderr
    assert read_image(out).shape == (48, 64, 3)


def test_scene_that_was_being_saved_says_there_is_none(tmp_path):
    script = """
        import os, signal, sys
        from support.scenes import make_scene
        seen = []
        def stop(event, arguments):
            seen.append(event)
            if event == "os.rename" and seen.count("os.rename") == 5:
                os.kill(os.getpid(), signal.SIGKILL)
        sys.addaudithook(stop)
        make_scene(8, 12).save(sys.argv[1])
    """
    assert python(script, tmp_path / "scene").returncode == -signal.SIGKILL
    assert len(list((tmp_path / "scene").iterdir())) >= 4
    with pytest.raises(ValueError, match="no scene here"):
        Scene.load(tmp_path / "scene")
