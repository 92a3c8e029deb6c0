# SPDX-License-Identifier: GPL-3.0-or-later
"""The room of a GUI test: what is left running is named and ends, patience is an idle machine's."""

import importlib.util
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[3] / "tools" / "gui_inside.py"
ALONE = ["unshare", "--mount-proc", "--pid", "--fork", "--kill-child", sys.executable, str(SCRIPT)]
needs_rooms = pytest.mark.skipif(
    not hasattr(os, "geteuid")
    or os.geteuid() != 0
    or shutil.which("unshare") is None
    or subprocess.call(["unshare", "--mount-proc", "--pid", "--fork", "true"], stderr=subprocess.DEVNULL)
    != 0,
    reason="a room of processes needs root, and a kernel that lets it",
)


@pytest.fixture
def inside():
    spec = importlib.util.spec_from_file_location("gui_inside", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_busy_machine_is_given_as_much_more_time(inside, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(os, "getloadavg", lambda: (6.0, 0.0, 0.0))
    patience = inside.Patience(10.0)
    now[0] += 29.0
    assert not patience.is_over
    now[0] += 2.0
    assert patience.is_over
    monkeypatch.setattr(os, "getloadavg", lambda: (0.5, 0.0, 0.0))
    patience = inside.Patience(10.0)
    now[0] += 10.5
    assert patience.is_over


@needs_rooms
def test_what_ends_leaves_nothing(tmp_path):
    left = tmp_path / "left.txt"
    assert subprocess.call([*ALONE, "20", str(left), "sh", "-c", "sleep 0.2 & exit 3"]) == 3
    assert left.read_text() == ""


@needs_rooms
def test_what_is_left_is_named_and_ended(inside, tmp_path, monkeypatch):
    left, mark = tmp_path / "left.txt", str(71_000_000 + os.getpid())
    room = [
        *ALONE[:-1],
        "-c",
        f"import sys; sys.path.insert(0, {str(SCRIPT.parent)!r}); import gui_inside as g",
    ]
    room[-1] += (
        f"; g.ENDING_SECONDS = 0.5; g.run(20, g.Path({str(left)!r}), ['sh', '-c', 'sleep {mark} & true'])"
    )
    assert subprocess.call(room) == 0
    assert left.read_text() == f"sleep {mark}\n"
    assert mark not in running()


@needs_rooms
def test_what_has_no_name_for_a_moment_is_there(tmp_path):
    """A process that is just becoming another program has an empty command line, as a zombie has."""
    left, mark = tmp_path / "left.txt", str(73_000_000 + os.getpid())
    starts = f"import subprocess; subprocess.Popen(['', '{mark}'], executable={shutil.which('sleep')!r})"
    room = f"import sys; sys.path.insert(0, {str(SCRIPT.parent)!r}); import gui_inside as g"
    room += f"; g.ENDING_SECONDS = 0.5; g.run(20, g.Path({str(left)!r}), [sys.executable, '-c', {starts!r}])"
    assert subprocess.call([*ALONE[:-1], "-c", room]) == 0
    assert left.read_text() == f"{mark}\n"


@needs_rooms
def test_a_room_ends_with_who_made_it(tmp_path):
    mark = str(72_000_000 + os.getpid())
    room = subprocess.Popen([*ALONE, "60", str(tmp_path / "left.txt"), "sleep", mark])
    end = time.monotonic() + 60.0
    while mark not in running() and time.monotonic() < end:
        time.sleep(0.05)
    room.kill()
    room.wait()
    while mark in running() and time.monotonic() < end:
        time.sleep(0.05)
    assert mark not in running()


def running() -> str:
    """All words of all command lines of this machine."""
    told = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            told.append(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:
            continue
    return " ".join(line for line in told if "gui_inside" not in line)
