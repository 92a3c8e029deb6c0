# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes that tell how far they are: real ones, of this Python."""

import sys
import time

import pytest

from physhdr.addon.session.process import is_alive
from physhdr.addon.session.task import ChildTask, TaskEnded, TaskProgress
from physhdr.bridge.errors import OutputError


def run(tmp_path, script, environment=None):
    task = ChildTask("work", [sys.executable, "-c", script], tmp_path / "work.log", environment)
    task.wait(20)
    return task.poll()


def test_progress_and_result_come_in_order_and_all_else_goes_to_the_log(tmp_path):
    script = """
import sys
print('{"progress": 0.5, "message": "half", "seconds_left": 3}')
print("a line for people")
print("{broken json")
print("on stderr", file=sys.stderr)
print('{"result": {"views": 18}}')
"""
    events = run(tmp_path, script)
    assert events == [
        TaskProgress("work", 0.5, "half", 3.0),
        TaskEnded("work", True, result={"views": 18}),
    ]
    log = (tmp_path / "work.log").read_text()
    assert "a line for people" in log and "on stderr" in log and "{broken json" in log


def test_an_error_is_told_with_its_hint(tmp_path):
    script = """
import sys
print('{"error": {"code": "no_camera", "message": "there is no camera", "hint": "Add one."}}')
sys.exit(1)
"""
    (ended,) = run(tmp_path, script)
    assert not ended.ok and ended.message == "there is no camera" and ended.hint == "Add one."


def test_a_crash_says_the_last_line_and_where_the_log_is(tmp_path):
    (ended,) = run(tmp_path, "raise RuntimeError('out of paint')")
    assert not ended.ok and "out of paint" in ended.message and str(tmp_path / "work.log") in ended.hint


def test_cancelling_interrupts_the_child_and_its_children(tmp_path):
    # The grandchild tells when it is there: a signal between fork and exec would miss it.
    grandchild = """
import os, time
print('{"progress": 0.1, "message": "%d"}' % os.getpid(), flush=True)
time.sleep(60)
"""
    script = f"import subprocess, sys; subprocess.call([sys.executable, '-c', {grandchild!r}])"
    task = ChildTask("work", [sys.executable, "-c", script], tmp_path / "work.log")
    deadline = time.monotonic() + 10
    events = []
    while not events and time.monotonic() < deadline:
        events = task.poll()
        time.sleep(0.01)
    pid = int(events[0].message)
    task.cancel()
    task.wait(20)
    (ended,) = task.poll()
    assert ended.cancelled and not ended.ok
    deadline = time.monotonic() + 5
    while is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(pid)


def is_running(pid):
    """Alive, and not a zombie that waits for its parent."""
    if not is_alive(pid):
        return False
    with open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0] != "Z"


def test_paths_of_any_letters_arrive_whatever_the_systems_encoding_is(tmp_path, monkeypatch):
    """As Windows has it: a code page of 256 letters for what goes into a pipe."""
    monkeypatch.setenv("PYTHONIOENCODING", "cp1252")
    monkeypatch.setenv("PYTHONUTF8", "0")
    grandchild = "print('fotos/日本 \\ufffd')"  # as pip's lines come through the installer
    script = f"import subprocess, sys; sys.exit(subprocess.call([sys.executable, '-c', {grandchild!r}]))"
    (ended,) = run(tmp_path, script)
    assert ended.ok, ended.message
    assert "fotos/日本 \ufffd" in (tmp_path / "work.log").read_text(encoding="utf-8")


def test_the_child_has_a_clean_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("KEPT", "yes")
    script = "import json, os; print(json.dumps({'result': dict(os.environ)}))"
    (ended,) = run(tmp_path, script)
    assert "PYTHONPATH" not in ended.result and ended.result["KEPT"] == "yes"
    assert ended.result["PYTHONNOUSERSITE"] == "1"


def test_a_program_that_is_not_there_is_named(tmp_path):
    with pytest.raises(OutputError, match="/no/such/python"):
        ChildTask("work", ["/no/such/python"], tmp_path / "work.log")
