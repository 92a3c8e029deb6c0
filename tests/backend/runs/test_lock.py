# SPDX-License-Identifier: GPL-3.0-or-later
"""One training a folder: who comes second is told who came first, and a killed one holds nothing."""

import json
import os
import signal
import subprocess
import sys
import textwrap

import pytest

from physhdr.backend.runs.lock import HOLDER_FILE, LOCK_FILE, RunHeldError, hold
from physhdr.bridge.errors import OutputError

HOLDER = """
    import sys, time
    from pathlib import Path
    from physhdr.backend.runs.lock import hold
    with hold(Path(sys.argv[1]), print):
        print("held", flush=True)
        time.sleep(60)
"""


@pytest.fixture
def another(tmp_path):
    """A process that holds ``tmp_path``."""
    command = [sys.executable, "-c", textwrap.dedent(HOLDER), str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_the_second_is_told_who_came_first(another, tmp_path):
    for _ in range(3):  # and a look does not disturb the first one's hold
        with pytest.raises(RunHeldError) as refused, hold(tmp_path, print):
            pass
        assert (
            f"process {another.pid} on " in refused.value.message and str(tmp_path) in refused.value.message
        )
        assert "--out" in refused.value.hint
    assert refused.value.code == "run_held"


def test_a_killed_holder_holds_nothing(another, tmp_path):
    another.send_signal(signal.SIGKILL)
    another.wait()
    assert (tmp_path / HOLDER_FILE).exists()  # it had no time to tidy
    with hold(tmp_path, print):
        assert json.loads((tmp_path / HOLDER_FILE).read_text())["pid"] == os.getpid()
    assert list(tmp_path.iterdir()) == []


def test_it_can_be_held_again_and_leaves_nothing(tmp_path):
    for _ in range(2):
        with hold(tmp_path, print):
            assert (tmp_path / LOCK_FILE).stat().st_mode & 0o077 == 0 or os.name == "nt"
        assert list(tmp_path.iterdir()) == []
    with pytest.raises(ZeroDivisionError), hold(tmp_path, print):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_where_a_disk_knows_no_locks_there_is_a_word_and_no_lock(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_):
        raise OSError(38, "Function not implemented")  # ENOSYS

    monkeypatch.setattr(fcntl, "flock", refuse)
    said = []
    with hold(tmp_path, said.append):
        pass
    assert len(said) == 1 and str(tmp_path) in said[0] and "twice at once" in said[0]


def test_a_folder_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="--out"), hold(tmp_path / "file", print):
        pass
