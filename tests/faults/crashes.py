"""``python -m faults.crashes``: an operation killed at every one of its steps on the file system.

Each file that Python opens, renames or removes is announced to its auditors beforehand. A forked
process runs the operation and kills itself (signal 9, nothing is cleaned up) at the n-th
announcement, for n = 1, 2, … until the operation comes to its end; after each, what lies in the
folder is checked, and the operation is run once more, whole.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.scenes import make_scene

from spotlight_runtime import Scene, read_image, write_image
from spotlight_runtime.planning.costs import Costs, Line, read_costs, write_costs
from spotlight_runtime.relighting.sweep import write_animation
from spotlight_spec import read_json, write_json

__all__ = ["OPERATIONS"]

EVENTS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.listdir"}
MOST_STEPS = 400

Folder = Path
Operation = tuple[Callable[[Folder], object], Callable[[Folder], object], Callable[[Folder], None]]
"""What makes the old state, what is killed while it makes the new one, and what checks."""


def killed_everywhere(name: str, root: Path) -> int:
    """Run an operation killed at each of its steps; how many there were."""
    prepare, work, check = OPERATIONS[name]
    for step in range(1, MOST_STEPS):
        folder = root / f"{name}-{step}"
        folder.mkdir()
        _whole(prepare, folder)
        status = _forked(_kill_at, step, work, folder)
        _whole(check, folder)
        _whole(work, folder)  # the next run is not in the way of what the killed one left
        _whole(check, folder)
        shutil.rmtree(folder)
        if os.WIFEXITED(status):
            assert os.WEXITSTATUS(status) == 0
            return step - 1
        assert os.WTERMSIG(status) == signal.SIGKILL
    raise AssertionError(f"{name} takes more than {MOST_STEPS} steps")


def _forked(action: Callable[..., object], *given: object) -> int:
    """Do something in a process of its own; its status.

    Never in this one, which would fork with threads that are just ending: one of OpenCV's holds a
    lock then, and in the copy nobody lets go of it.
    """
    child = os.fork()
    if child == 0:
        try:
            action(*given)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    return os.waitpid(child, 0)[1]


def _whole(action: Callable[[Folder], object], folder: Folder) -> None:
    status = _forked(action, folder)
    assert os.waitstatus_to_exitcode(status) == 0, folder


def _kill_at(step: int, work: Callable[[Folder], object], folder: Folder) -> None:
    left = [step]

    def count(event: str, arguments: object) -> None:
        if event in EVENTS:
            left[0] -= 1
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count)
    work(folder)


OLD, NEW = np.full((8, 12, 3), 0.25, np.float32), np.full((8, 12, 3), 0.75, np.float32)


def picture(suffix: str) -> Operation:
    def check(folder: Path) -> None:
        value = float(read_image(folder / f"a{suffix}").mean())
        assert min(abs(value - 0.25), abs(value - 0.75)) < 0.02, value

    return (
        lambda folder: write_image(folder / f"a{suffix}", OLD),
        lambda folder: write_image(folder / f"a{suffix}", NEW),
        check,
    )


def _check_scene(folder: Path) -> None:
    """The old one, the new one, or none: never some maps of each."""
    if not (folder / "scene/scene.json").exists():
        return
    scene = Scene.load(folder / "scene")
    wanted = make_scene(8, 12, seed=1 if scene.name == "old" else 2)
    np.testing.assert_array_equal(scene.background, wanted.background)
    np.testing.assert_allclose(
        scene.background_maps.albedo, wanted.background_maps.albedo, atol=1e-4
    )


def _save_scene(folder: Path, name: str, seed: int) -> None:
    from dataclasses import replace

    replace(make_scene(8, 12, seed), name=name).save(folder / "scene")


def _check_record(folder: Path) -> None:
    assert read_json(folder / "a.json") in ({"of": "old"}, {"of": "new"})


def _check_film(folder: Path) -> None:
    from PIL import Image

    with Image.open(folder / "a.gif") as film:
        film.seek(film.n_frames - 1)
        film.load()
        assert film.n_frames in (2, 3)


def _frames(count: int) -> list[np.ndarray]:
    return [np.full((8, 12, 3), (i + 1) / 4, np.float32) for i in range(count)]


def _costs(value: float) -> Costs:
    return Costs(**dict.fromkeys(Costs.__dataclass_fields__, Line(value, value)))


def _check_costs(folder: Path) -> None:
    found = read_costs(folder / "costs.json")
    assert found is not None
    assert found.evaluation.fixed in (1.0, 2.0)


OPERATIONS: dict[str, Operation] = {
    "png": picture(".png"),
    "jpg": picture(".jpg"),
    "exr": picture(".exr"),
    "record": (
        lambda folder: write_json(folder / "a.json", {"of": "old"}),
        lambda folder: write_json(folder / "a.json", {"of": "new"}),
        _check_record,
    ),
    "scene": (
        lambda folder: _save_scene(folder, "old", 1),
        lambda folder: _save_scene(folder, "new", 2),
        _check_scene,
    ),
    "film": (
        lambda folder: write_animation(folder / "a.gif", _frames(2)),
        lambda folder: write_animation(folder / "a.gif", _frames(3)),
        _check_film,
    ),
    "costs": (
        lambda folder: write_costs(folder / "costs.json", _costs(1.0)),
        lambda folder: write_costs(folder / "costs.json", _costs(2.0)),
        _check_costs,
    ),
}

if __name__ == "__main__":
    for each in sys.argv[2:]:
        print(each, killed_everywhere(each, Path(sys.argv[1])))
