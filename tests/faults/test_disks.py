"""Full disks and read-only folders: one clear error, nothing half-written, and then it works."""

import subprocess

from faults.processes import environment, in_a_namespace, python, spotlight

FULL = """
    import sys
    from pathlib import Path
    import numpy as np
    from spotlight_runtime import Scene, read_image, write_image
    from spotlight_runtime.errors import SpotLightError
    from support.scenes import make_scene

    folder, small, large = Path(sys.argv[1]), (8, 12, 3), (400, 400, 3)
    noise = np.random.default_rng(0).random(large, dtype=np.float32)
    for suffix in (".png", ".jpg", ".webp", ".hdr", ".exr"):
        path = folder / f"a{suffix}"
        write_image(path, np.full(small, 0.5, np.float32))
        before = path.read_bytes()
        try:
            write_image(path, noise)
        except SpotLightError as error:
            assert f"a{suffix}: cannot be written" in str(error), error
        else:
            raise AssertionError(f"{path} was written to a full disk")
        assert path.read_bytes() == before
        assert [p.name for p in folder.iterdir()] == [path.name]
        path.unlink()
    try:
        make_scene(200, 200).save(folder / "scene")
    except SpotLightError as error:
        print(error)
    else:
        raise AssertionError("a scene was saved to a full disk")
    assert not (folder / "scene/scene.json").exists()
    for path in (folder / "scene").iterdir():
        assert not path.name.endswith(".partial"), path
        path.unlink()
    make_scene(8, 8).save(folder / "scene")
    assert Scene.load(folder / "scene").size == (8, 8)
    print("done")
"""


def test_full_disk():
    """A file system of 64 KiB."""
    done = in_a_namespace(
        """
        mount -t tmpfs -o size=64k none /mnt
        "$PYTHON" -W error -c "$1" /mnt
        """,
        _dedented(FULL),
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "No space left on device" in done.stdout
    assert done.stdout.endswith("done\n")


def test_files_no_larger_than_the_limit(tmp_path):
    """``ulimit -f``, which needs no rights: a write beyond it fails as on a full disk."""
    script = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))\n"
    done = python(script + _dedented(FULL), tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.endswith("done\n")


def test_relight_to_a_full_disk(asked):
    """The command says so in one line, and the picture of before is whole."""
    done = in_a_namespace(
        """
        mount -t tmpfs -o size=16k none /mnt
        head -c 8000 /dev/zero > /mnt/out.exr
        shift 0
        "$@" -o /mnt/out.exr 2> /mnt/../tmp/said || code=$?
        cat /mnt/../tmp/said >&2
        test "$code" = 1
        test "$(stat -c %s /mnt/out.exr)" = 8000
        test "$(ls -A /mnt)" = out.exr
        """,
        *spotlight(*asked),
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "out.exr: cannot be written" in done.stderr


def test_read_only_folders(asked, place, backbone):
    """Scene, model and home on a read-only disk are read; an output there is refused at once."""
    done = in_a_namespace(
        """
        for folder in "$1" "$2"; do
            mount --bind "$folder" "$folder"
            mount -o remount,ro,bind "$folder"
        done
        out="$1/out.png"
        shift 2
        export HOME=/proc XDG_CACHE_HOME=/proc/nowhere
        mount -t tmpfs none /mnt
        "$@" -o /mnt/out.png
        test -s /mnt/out.png
        if "$@" -o "$out"; then exit 3; fi
        """,
        place,
        backbone,
        *spotlight(*asked),
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "is read-only" in done.stderr
    assert done.stderr.count("evaluations") == 1, "the second was refused before the relight"


def test_folder_that_is_not_there_is_named_before_the_relight(asked, tmp_path):
    done = subprocess.run(
        spotlight(*asked, "-o", tmp_path / "nowhere/out.png"),
        capture_output=True,
        text=True,
        env=environment(),
        check=False,
    )
    assert done.returncode == 1
    assert "there is no folder" in done.stderr


def _dedented(script: str) -> str:
    import textwrap

    return textwrap.dedent(script)
