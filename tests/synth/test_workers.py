# SPDX-License-Identifier: GPL-3.0-or-later
"""Several processes on one folder: the same files as one alone makes, and nobody is left behind."""

import hashlib
import os
import shutil
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import filelock
import pytest

import physhdr.synth.workers as workers
from physhdr.synth import dataset
from physhdr.synth.errors import OptionError
from physhdr.synth.renderer import Renderer
from physhdr.tests.synth.open_scene import user_scene

ASKED = ["--resolution", "24", "--samples", "2", "--views", "6", "--lit-views", "2"]


def digests(out: Path) -> dict[str, str]:
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != "dataset.json"  # it tells the number of threads
    }


@pytest.mark.long
def test_workers_make_the_same_files(tmp_path):
    room = user_scene.saved(tmp_path / "room.blend")
    for name, count in (("one", "1"), ("two", "2")):
        where = ["--from-file", str(room), "--out", str(tmp_path / name), "--workers", count]
        command = [sys.executable, str(workers.SCRIPT), "--", *where, *ASKED]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    one, two = digests(tmp_path / "one"), digests(tmp_path / "two")
    assert len(one) > 40 and one == two
    assert not list((tmp_path / "two").glob(".*"))


#: A Blender that has no filelock of its own.
LACKS = """
import importlib.machinery, runpy, sys
from pathlib import Path

class Lacking(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        bundled = [entry for entry in sys.path if entry.endswith(".whl")]
        return super().find_spec(name, bundled if name == "filelock" else path, target)

sys.meta_path[:] = [Lacking if each is importlib.machinery.PathFinder else each for each in sys.meta_path]
runpy.run_path(sys.argv[1])
from physhdr.bridge.lock import Claims
with Claims(Path(sys.argv[2]), print) as claims:
    print(claims.take("train_000"), sys.modules["physhdr"].__path__[0])
"""


@pytest.mark.parametrize("bundled", [True, False])
def test_in_a_folder_of_any_name_the_script_takes_what_the_extension_bundles(tmp_path, bundled):
    root = tmp_path / "My Copy-1.2 (two)"
    for room in ("synth", "bridge"):
        shutil.copytree(workers.SCRIPT.parents[1] / room, root / room)
    shutil.copy(workers.SCRIPT.parents[1] / "__init__.py", root)
    if bundled:
        library = Path(filelock.__file__).parent
        (root / "wheels").mkdir()
        with zipfile.ZipFile(root / "wheels" / "filelock-0-py3-none-any.whl", "w") as wheel:
            for path in library.rglob("*.py"):
                wheel.write(path, path.relative_to(library.parent))
    arguments = [root / "synth" / "make_scene.py", tmp_path / "data" / ".claims"]
    done = subprocess.run([sys.executable, "-c", LACKS, *arguments], capture_output=True, text=True)
    told = [f"True {root}"]
    if not bundled:
        where = tmp_path / "data"
        told = [
            f"{where} cannot be locked (this Python has no filelock): do not work there twice at once",
            *told,
        ]
    assert done.stdout.splitlines() == told, done.stderr


def test_a_worker_ends_when_its_parent_is_gone():
    code = (
        "import subprocess, sys\n"
        "child = subprocess.Popen([sys.executable, '-c', sys.argv[1]], stdout=subprocess.PIPE, text=True)\n"
        "while child.stdout.readline() != 'began\\n':\n"
        "    assert child.poll() is None\n"
        "print(child.pid, flush=True)\n"
    )
    worker = (
        "import os, time\n"
        "from physhdr.synth.workers import WorkerReport\n"
        "report = WorkerReport(os.getppid())\n"
        "report.start('first')\n"
        "print('began', flush=True)\n"
        "while True:\n"
        "    time.sleep(0.1)\n"
        "    report.start('next')\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, worker], check=True, capture_output=True, text=True, timeout=60
    )
    pid = ended.stdout.split()[-1]
    deadline = time.monotonic() + 20
    while _runs(int(pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _runs(int(pid))


def _runs(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_parts_share_the_poses_and_the_last_step_has_nothing_to_render(tmp_path, small, monkeypatch):
    real, rendered = Renderer.render, []

    def counted(self, pose, seed, scratch):
        rendered.append(scratch.name)
        return real(self, pose, seed, scratch)

    monkeypatch.setattr(Renderer, "render", counted)
    out, whole = tmp_path / "parts", tmp_path / "whole"
    told = dataset.make(out, replace(small, part=(3, 3), threads=1))
    took = told.pop("picture_seconds")
    assert told == {"folder": str(out), "part": [3, 3]}
    assert len(took) == len(rendered) and all(seconds > 0.0 for seconds in took)
    assert 0 < len(rendered) == len(list((out / "passes").iterdir())) < 4 and not list(out.glob(".*"))
    assert not (out / "dataset.json").exists() and not (out / "points3d.ply").exists()
    for k in (1, 2, 2):
        dataset.make(out, replace(small, part=(k, 3)))
    poses = small.views + small.lit_views
    assert len(rendered) == poses == len(list((out / "passes").iterdir()))
    dataset.make(out, small)
    assert len(rendered) == poses + 1  # and the noise
    dataset.make(out, replace(small, part=(1, 3)))  # complete: nothing to do
    dataset.make(whole, small)
    assert digests(out) == digests(whole) and len(rendered) == 2 * (poses + 1)
    assert (out / "dataset.json").read_bytes() == (whole / "dataset.json").read_bytes()


def test_an_unsaved_scene_cannot_be_shared():
    workers.bpy.ops.wm.read_homefile(
        use_empty=True, use_factory_startup=True
    )  # another test may have left a file open
    with pytest.raises(OptionError, match="save the file first"), workers.helping(1, [], "current"):
        pass


@pytest.mark.parametrize(("allowed", "switch"), [(True, "-y"), (False, "-Y")])
def test_workers_run_the_files_python_if_this_process_may(monkeypatch, allowed, switch):
    """Else their scene is another one, and none of them helps."""
    app, data = SimpleNamespace(binary_path="blender"), SimpleNamespace(filepath="room.blend")
    monkeypatch.setattr(workers, "bpy", SimpleNamespace(app=app, data=data))
    monkeypatch.setattr(workers.scripts, "may_run", lambda: allowed)
    assert workers._command("current")[:4] == ["blender", "--background", switch, "room.blend"]


def test_cores_are_shared_out():
    cores = len(os.sched_getaffinity(0))
    assert workers.threads_each(1) == cores
    assert workers.threads_each(cores) == 1 == workers.threads_each(10 * cores)
