"""The runtime starts fast and brings nothing along that it must not know."""

import subprocess
import sys
import textwrap

FORBIDDEN = ("torch", "diffusers", "transformers", "onnx", "fastapi", "spotlight_export")


def run(script, *arguments):
    command = [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_leaves_the_heavy_and_the_forbidden_out():
    script = """
        import sys
        import spotlight_runtime
        print(*sorted(m.partition(".")[0] for m in sys.modules))
    """
    loaded = set(run(script).split())
    assert not loaded & {*FORBIDDEN, "pyoidn", "onnxruntime"}


def test_specification_needs_the_standard_library_alone():
    script = """
        import sys
        before = set(sys.modules)
        import spotlight_spec
        print(*sorted({m.partition(".")[0] for m in set(sys.modules) - before}))
    """
    foreign = set(run(script).split()) - sys.stdlib_module_names
    assert foreign == {"spotlight_spec"}


def test_relight_leaves_the_forbidden_out_even_where_it_is_installed(backbone, tmp_path):
    script = """
        import sys
        sys.path.insert(0, sys.argv[2])
        from support.scenes import make_scene, make_shadow
        from spotlight_runtime import Relighter, RelightOptions

        scene = make_scene(16, 24)
        relighter = Relighter.load(sys.argv[1], threads=1)
        relighter.relight(scene, make_shadow(scene), options=RelightOptions(steps=1))
        print(*sorted({m.partition(".")[0] for m in sys.modules}))
    """
    tests = __file__.rpartition("/runtime/")[0]
    loaded = set(run(script, backbone, tests).split())
    assert "onnxruntime" in loaded
    assert not loaded & set(FORBIDDEN)


def test_import_costs_little_more_than_the_libraries_it_stands_on():
    """Half a second is wanted; that is another amount of work everywhere, so libraries measure."""
    script = """
        import time
        start = time.process_time()
        import cv2, numpy
        libraries = time.process_time() - start
        import spotlight_runtime
        print((time.process_time() - start) / libraries)
    """
    assert min(float(run(script)) for _ in range(5)) < 2.5


def test_public_names_are_there():
    import spotlight_runtime

    for name in spotlight_runtime.__all__:
        assert getattr(spotlight_runtime, name).__doc__
