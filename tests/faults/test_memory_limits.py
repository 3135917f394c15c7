"""``ulimit -v``: a relight comes to its end or to one clear line, wherever memory ends."""

import resource
import subprocess
import sys

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow

from faults.processes import environment, python, spotlight
from spotlight_runtime import read_image, write_image

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits address space")
MIB = 1 << 20


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """A photograph of a megapixel and a half."""
    folder = tmp_path_factory.mktemp("large")
    scene = make_scene(1000, 1500)
    scene.save(folder / "scene")
    write_image(folder / "shadow.png", make_shadow(scene))
    return folder


def limited(command, bytes_):
    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (bytes_, bytes_))

    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=environment(OPENBLAS_NUM_THREADS="1"),
        preexec_fn=limit,
        check=False,
    )


def needed():
    """Address space that Python and the imports take."""
    said = python(
        "import spotlight_runtime.cli, onnxruntime; print(open('/proc/self/statm').read())"
    )
    return int(said.stdout.split()[0]) * resource.getpagesize()


def test_out_of_memory_is_one_line(large, backbone, tmp_path):
    arguments = ["relight", large / "scene", "--shadow", large / "shadow.png", "--model", backbone]
    out = tmp_path / "out.png"
    command = spotlight(*arguments, "--no-denoise", "--threads", "1", "-o", out)
    start, refused, done = needed(), 0, False
    for more in (32, 96, 192, 384, 4096):
        said = limited(command, start + more * MIB)
        if said.returncode == 0:
            done = True
            assert read_image(out).shape == (1000, 1500, 3)
            break
        refused += 1
        assert said.returncode == 1, (more, said.returncode, said.stderr[-2000:])
        assert "Traceback" not in said.stderr, said.stderr[-2000:]
        (line,) = said.stderr.split("\n")[-2:-1] if said.stderr.strip() else [""]
        assert line.startswith("spotlight: ")
        assert said.stderr.strip() == line, "one line, after the progress bar's own empty one"
        assert not list(tmp_path.iterdir())
    assert done, "with enough memory it works"
    assert refused >= 2, "the limits are tight enough to be met"


def test_a_limit_while_a_process_runs(backbone, place):
    """The relight that ran out is an error; with the limit lifted, the next one succeeds."""
    script = """
        import ctypes, resource, sys
        ctypes.CDLL(None).mallopt(-3, 1 << 20)  # what is freed is given back, not kept for later
        from spotlight_runtime import Relighter, Scene, read_image
        from spotlight_runtime.errors import SpotLightError
        from support.scenes import make_scene, make_shadow
        relighter = Relighter.load(sys.argv[2], threads=1)
        small = Scene.load(sys.argv[1] + "/scene")
        shadow = read_image(sys.argv[1] + "/shadow.png")
        before = relighter.relight(small, shadow, denoise=False).image.tobytes()
        scene = make_scene(1000, 1500)
        drawn = make_shadow(scene)
        now = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + (8 << 20), resource.RLIM_INFINITY))
        try:
            relighter.relight(scene, drawn, denoise=False)
        except (MemoryError, SpotLightError) as error:
            print("refused:", type(error).__name__)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        assert relighter.relight(small, shadow, denoise=False).image.tobytes() == before
        print("whole")
    """
    done = python(script, place, backbone)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.startswith("refused:")
    assert done.stdout.endswith("whole\n")
    assert np.isfinite(read_image(place / "shadow.png")).all()
