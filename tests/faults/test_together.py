"""Two processes with one output, one scene, one cache: whole files of one or of the other."""

import subprocess
import sys
import textwrap

import numpy as np

from faults.processes import environment
from spotlight_runtime import Scene, read_image
from spotlight_runtime.errors import SceneError
from spotlight_runtime.planning.costs import read_costs

ROUNDS = 12
WRITE = """
    import sys
    from dataclasses import replace
    from pathlib import Path
    import numpy as np
    from spotlight_runtime import write_image
    from spotlight_runtime.planning.costs import Costs, Line, write_costs
    from support.scenes import make_scene

    folder, mine, rounds = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    scene = replace(make_scene(24, 32, seed=mine), name=str(mine))
    picture = np.full((200, 200, 3), mine / 4, np.float32)
    costs = Costs(**dict.fromkeys(Costs.__dataclass_fields__, Line(float(mine), 1.0)))
    print("ready", flush=True)
    sys.stdin.readline()
    for _ in range(rounds):
        for suffix in (".png", ".exr"):
            write_image(folder / f"a{suffix}", picture)
        write_costs(folder / "costs.json", costs)
        scene.save(folder / "scene")
"""


def test_two_writers_and_a_reader(tmp_path):
    """The reader meets a file of one or of the other, or none; of a scene never maps of both."""
    command = [sys.executable, "-c", textwrap.dedent(WRITE), str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    writers = [
        subprocess.Popen([*command, str(i), str(ROUNDS)], text=True, env=environment(), **pipes)
        for i in (1, 2)
    ]
    for writer in writers:
        assert writer.stdout.readline() == "ready\n"
    for writer in writers:
        writer.stdin.write("go\n")
        writer.stdin.flush()
    seen = set()
    while any(writer.poll() is None for writer in writers):
        seen.add(_look(tmp_path))
    for writer in writers:
        writer.communicate()
        assert writer.returncode == 0
    assert _look(tmp_path) in {"1", "2"}
    assert seen & {"1", "2"}, "the reader met at least one whole scene"
    assert not list(tmp_path.rglob("*.partial"))


def _look(folder):
    """Read all that is there, check that it is whole, and say whose scene it was."""
    for suffix in (".png", ".exr"):
        if (folder / f"a{suffix}").exists():
            pixels = read_image(folder / f"a{suffix}")
            assert np.ptp(pixels) == 0.0
            assert min(abs(pixels.mean() - mine / 4) for mine in (1, 2)) < 0.01
    costs = read_costs(folder / "costs.json")
    assert costs is None or costs.evaluation.fixed in (1.0, 2.0)
    try:
        scene = Scene.load(folder / "scene")
    except (SceneError, OSError):
        return "none"
    assert _is_of(scene, int(scene.name))
    return scene.name


def _is_of(scene, seed):
    from support.scenes import make_scene

    wanted = make_scene(24, 32, seed=seed)
    return (
        np.array_equal(scene.background, wanted.background)
        and np.abs(scene.background_maps.albedo - wanted.background_maps.albedo).max() < 1e-4
        and np.abs(scene.truth - wanted.truth).max() < 1e-4
    )
