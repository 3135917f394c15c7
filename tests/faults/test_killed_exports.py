"""An export killed at any stage: what lies in its place is the old model, the new one, or none."""

import os
import signal
import subprocess
import sys
import textwrap

import pytest

pytest.importorskip("torch", reason="exporting needs the extra export")
pytest.importorskip("diffusers", reason="exporting needs the extra export")

from support.checkpoints import write_tiny_checkpoint

from faults.processes import environment, python
from spotlight_export.folder import new_model_folder, read_model
from spotlight_runtime.networks.models import open_networks, resolve_model

EXPORT = """
    import sys
    from spotlight_export.export import export_backbone
    base, controlnet, out, wait = sys.argv[1:]
    def report(line):
        print(line, flush=True)
        if line == wait:
            sys.stdin.readline()
    export_backbone("zerocomp", base, controlnet, out, force=True, report=report)
"""


@pytest.mark.full
def test_killed_in_mid_export(tmp_path):
    """Tracing takes a minute of processor time; the other tests kill what renames, in seconds."""
    checkpoint = write_tiny_checkpoint(tmp_path / "checkpoint")
    out = tmp_path / "models/tiny"
    arguments = [str(checkpoint.base), str(checkpoint.controlnet), str(out)]
    stage = "writing condition_encoder.onnx"
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(EXPORT), *arguments, stage],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment(),
    ) as process:
        assert stage + "\n" in iter(process.stdout.readline, "")
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    assert not out.exists()
    (left,) = out.parent.iterdir()
    assert not (left / "manifest.json").exists()
    with pytest.raises(LookupError):
        resolve_model(left)
    done = python(EXPORT, *arguments, "")
    assert done.returncode == 0, done.stderr
    assert not read_model(out).damaged_files(out)
    assert len(open_networks(resolve_model(out))) == 4


REPLACE = """
    import os, signal, sys
    from pathlib import Path
    from spotlight_export.folder import new_model_folder
    from support.onnx_backbone import write_backbone
    left = int(sys.argv[2])
    def stop(event, arguments):
        global left
        if event in ("os.rename", "os.remove", "os.rmdir", "os.mkdir"):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(stop)
    with new_model_folder(Path(sys.argv[1]), force=True) as folder:
        write_backbone(folder, seed=2)
"""


def test_killed_while_a_model_is_replaced(tmp_path):
    """At each rename and removal. Whatever is found by name is whole."""
    from support.onnx_backbone import write_backbone

    seen = set()
    for step in range(1, 30):
        root = tmp_path / str(step)
        root.mkdir()
        old = write_backbone(root / "tiny", seed=1).joinpath("denoiser.onnx").read_bytes()
        done = python(REPLACE, root / "tiny", step)
        os.environ["SPOTLIGHT_MODELS"] = str(root)
        try:
            model = resolve_model("zerocomp-openrooms")
        except LookupError:
            seen.add("none")
        else:
            assert len(open_networks(model)) == 4
            graph = (model.path / "denoiser.onnx").read_bytes()
            seen.add("old" if graph == old else "new")
        finally:
            del os.environ["SPOTLIGHT_MODELS"]
        if done.returncode == 0:
            break
        assert done.returncode == -signal.SIGKILL, done.stderr
    assert seen == {"old", "new"}


def test_numbers_of_processes_repeat_and_do_not_clash(tmp_path):
    """In a container the next export has the killed one's number."""
    (tmp_path / f"tiny.partial-{os.getpid()}").mkdir()
    with new_model_folder(tmp_path / "tiny") as folder:
        (folder / "a").write_text("whole")
    assert (tmp_path / "tiny/a").read_text() == "whole"
    assert (tmp_path / "tiny").stat().st_mode & 0o777 == 0o755
