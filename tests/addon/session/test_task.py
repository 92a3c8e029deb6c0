# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes that tell how far they are: real ones, of this Python."""

import os
import signal
import stat
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

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
    pid = int(first_word(task).message)
    task.cancel()
    task.wait(20)
    (ended,) = task.poll()
    assert ended.cancelled and not ended.ok
    until(lambda: not is_running(pid))


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
    task = ChildTask("work", ["/no/such/python"], tmp_path / "work.log")
    task.wait(20)
    (ended,) = task.poll()
    assert not ended.ok and "/no/such/python" in ended.message and ended.hint == "Check the path."


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")
def test_how_a_program_ended_is_told(tmp_path):
    (ended,) = run(tmp_path, "import sys; sys.exit(7)")
    assert "ended with status 7" in ended.message
    (ended,) = run(tmp_path, "import os; os.kill(os.getpid(), 9)")
    assert "ended by signal 9" in ended.message
    (ended,) = run(tmp_path, "import os, signal; os.kill(os.getpid(), signal.SIGTERM)")
    assert "ended by signal 15" in ended.message


#: Says that it is there, and when it is interrupted, cleans up for a moment. CTRL-C comes to it alone.
TIDY = """
import pathlib, time
try:
    print('{"progress": 0.1}', flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    time.sleep(0.3)
    pathlib.Path("%s").write_text("tidied up")
"""


def test_a_cancelled_child_has_time_to_clean_up(tmp_path):
    task = ChildTask("work", [sys.executable, "-c", TIDY % (tmp_path / "tidied")], tmp_path / "work.log")
    first_word(task)
    task.cancel()
    task.cancel()
    task.wait(20)
    (ended,) = task.poll()
    assert ended.cancelled and (tmp_path / "tidied").read_text() == "tidied up"


def test_a_child_ends_with_the_blender_that_started_it(tmp_path):
    """As when it crashes: the system closes its end of the pipe, whatever else it leaves undone."""
    command = [sys.executable, "-c", TIDY % (tmp_path / "tidied")]
    blender = f"""
import time
from pathlib import Path
from physhdr.addon.session.task import ChildTask
task = ChildTask("work", {command!r}, Path({str(tmp_path / "work.log")!r}))
while not task.poll():
    time.sleep(0.01)
print("there", flush=True)
time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", blender], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "there\n"
        process.kill()
    until((tmp_path / "tidied").exists)


def test_a_child_that_does_not_heed_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr("physhdr.addon.session.task.PATIENCE", 0.5)
    deaf = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    deaf += "print('{\"progress\": 0.1}', flush=True); time.sleep(60)"
    task = ChildTask("work", [sys.executable, "-c", deaf], tmp_path / "work.log")
    first_word(task)
    begun = time.monotonic()
    task.cancel()
    task.wait(20)
    (ended,) = task.poll()
    assert ended.cancelled and 0.4 < time.monotonic() - begun < 5.0


@pytest.mark.skipif(os.name == "nt", reason="Windows limits no file's size")
def test_a_full_disk_ends_the_log_and_not_the_task(tmp_path, small_disk):
    """Here a limit of a file's size: nobody writes the log any more, and all that is said is still read."""
    script = """
for i in range(4000):
    print("line", i, 30 * "x")
print('{"error": {"message": "the disk is full", "hint": "Free some space."}}')
raise SystemExit(1)
"""
    with small_disk(4096):
        (ended,) = run(tmp_path, script)
    assert not ended.ok and ended.message == "the disk is full" and ended.hint == "Free some space."
    assert (tmp_path / "work.log").stat().st_size <= 4096


def test_a_thread_that_fails_ends_the_task_and_its_child(tmp_path, monkeypatch):
    """Whatever it is that nobody thought of: a task without an end would be shown for ever."""
    monkeypatch.setattr("physhdr.addon.session.task._json_line", lambda line: 1 / 0)
    monkeypatch.setattr(threading, "excepthook", lambda told: None)
    task = ChildTask("work", [sys.executable, "-c", TIDY % (tmp_path / "tidied")], tmp_path / "work.log")
    task.wait(20)
    (ended,) = task.poll()
    assert not ended.ok and "cannot be read" in ended.message
    until((tmp_path / "tidied").exists)


def test_a_task_that_cannot_start_leaves_nothing_open(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    before = os.listdir("/proc/self/fd")
    with pytest.raises(OutputError, match="/no/such/python"):
        ChildTask("work", ["anything"], tmp_path / "work.log")
    assert os.listdir("/proc/self/fd") == before
    (tmp_path / "a folder").mkdir()
    with pytest.raises(OutputError, match="cannot write"):
        ChildTask("work", ["anything"], tmp_path / "a folder")


@pytest.mark.skipif(os.name == "nt", reason="Windows' folders have no modes")
def test_the_folder_of_its_log_is_its_owners_alone(tmp_path):
    """It is the home, and whatever is done first may be what makes it."""
    before = os.umask(0)
    try:
        task = ChildTask("work", [sys.executable, "-c", ""], tmp_path / "home" / "work.log")
    finally:
        os.umask(before)
    task.wait(20)
    assert stat.S_IMODE((tmp_path / "home").stat().st_mode) == 0o700


@pytest.fixture
def small_disk():
    """``with small_disk(BYTES)``: no file of this process may become larger. Raised as a full disk is."""
    import resource

    @contextmanager
    def limited(size):
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
            signal.signal(signal.SIGXFSZ, ignored)

    return limited


def first_word(task):
    """Wait until the child tells something; what it tells."""
    events = []
    until(lambda: events.extend(task.poll()) or events)
    return events[0]


def until(condition, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)
