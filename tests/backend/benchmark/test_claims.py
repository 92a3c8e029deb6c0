# SPDX-License-Identifier: GPL-3.0-or-later
"""Of several who want the same run, one gets it; what dead ones held is taken over."""

import json
import os
import socket
import subprocess
import sys
import threading

import pytest

from physhdr.backend.benchmark import claims as module
from physhdr.backend.benchmark.claims import STALE_AFTER, Claims
from physhdr.bridge.errors import OutputError

linux = pytest.mark.skipif(not os.path.exists("/proc/self/ns/pid"), reason="needs Linux's /proc")


@pytest.fixture
def dead_pid():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_one_of_many_gets_it(tmp_path):
    claims = [Claims(tmp_path / "claims") for _ in range(8)]
    won = []
    barrier = threading.Barrier(8)

    def want(each):
        barrier.wait()
        for k in range(20):
            if each.take(f"run_{k}"):
                won.append(k)

    threads = [threading.Thread(target=want, args=(each,)) for each in claims]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(won) == list(range(20))


def test_what_is_held_is_seen_and_given_back(tmp_path):
    other = Claims(tmp_path / "claims")
    with Claims(tmp_path / "claims") as mine:
        assert mine.take("run") and not other.take("run")
        assert other.is_taken("run") and not mine.is_taken("run")
    assert not other.is_taken("run") and not (tmp_path / "claims").exists()
    assert other.take("run")


def grow_stale(path):
    long_ago = path.stat().st_mtime - STALE_AFTER - 1
    os.utime(path, (long_ago, long_ago))


@linux
def test_a_dead_process_holds_nothing(tmp_path, dead_pid):
    assert Claims(tmp_path, pid=dead_pid).take("run")
    mine = Claims(tmp_path)
    assert not mine.is_taken("run") and mine.take("run")


@linux
def test_a_living_process_keeps_its_claim_however_long_it_was_stopped(tmp_path):
    """CTRL-Z stops the command; its jobs, in sessions of their own, go on."""
    theirs, mine = Claims(tmp_path), Claims(tmp_path)
    assert theirs.take("run")
    grow_stale(tmp_path / "run")
    assert mine.is_taken("run") and not mine.take("run")


@linux
def test_a_number_that_another_process_has_now_keeps_nothing(tmp_path):
    assert Claims(tmp_path).take("run")
    owner = json.loads((tmp_path / "run").read_text())
    (tmp_path / "run").write_text(json.dumps(owner | {"started": owner["started"] - 1}))
    assert Claims(tmp_path).take("run")


@linux
def test_a_process_that_died_and_is_not_yet_missed_holds_nothing(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    theirs = Claims(tmp_path, pid=process.pid)
    assert theirs.take("run") and process.stdout is not None
    process.stdout.read()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # a zombie now
    assert Claims(tmp_path).take("run")
    process.wait()


@pytest.mark.parametrize("elsewhere", ["another-boot 4026531836", None])
def test_a_claim_from_elsewhere_dies_without_signs_of_life_alone(tmp_path, monkeypatch, dead_pid, elsewhere):
    """Another machine or container, though of the same name: its process numbers mean nothing here."""
    monkeypatch.setattr(module, "_machine", lambda: elsewhere)
    theirs = Claims(tmp_path, pid=dead_pid)
    assert theirs.take("run")
    monkeypatch.undo()
    mine = Claims(tmp_path)
    assert mine.is_taken("run") and not mine.take("run")
    grow_stale(tmp_path / "run")
    assert mine.take("run")
    theirs.release("run")  # it is no longer theirs to give back
    assert (tmp_path / "run").exists()


def test_a_claim_of_an_earlier_version_is_understood(tmp_path, dead_pid):
    """It does not say on which machine its process number means something: its last touch decides."""
    owner = {"host": socket.gethostname(), "pid": dead_pid, "token": "1f2bbed20c085684"}
    (tmp_path / "run").write_text(json.dumps(owner))
    mine = Claims(tmp_path)
    assert mine.is_taken("run") and not mine.take("run")
    grow_stale(tmp_path / "run")
    assert mine.take("run")


@linux
def test_who_comes_late_to_bury_a_claim_leaves_the_new_one(tmp_path, monkeypatch, dead_pid):
    assert Claims(tmp_path, pid=dead_pid).take("run")
    mine, theirs = Claims(tmp_path), Claims(tmp_path)
    rename = os.rename

    def late(source, target):  # they take it between our look at the dead claim and its burial
        monkeypatch.setattr(os, "rename", rename)
        assert theirs.take("run")
        rename(source, target)

    monkeypatch.setattr(os, "rename", late)
    assert not mine.take("run") and mine.is_taken("run")
    theirs.release("run")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_is_one_clear_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write claims into"):
        Claims(tmp_path / "file").take("run")
    with pytest.raises(OutputError, match="cannot write claims into"), Claims(tmp_path / "file" / "claims"):
        pass
