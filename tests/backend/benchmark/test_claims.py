# SPDX-License-Identifier: GPL-3.0-or-later
"""Of several who want the same run, one gets it; what dead ones held is taken over."""

import os
import subprocess
import sys
import threading

import pytest

from physhdr.backend.benchmark.claims import STALE_AFTER, Claims


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


def test_a_dead_process_holds_nothing(tmp_path, dead_pid):
    assert Claims(tmp_path, pid=dead_pid).take("run")
    mine = Claims(tmp_path)
    assert not mine.is_taken("run") and mine.take("run")


def test_a_claim_of_another_machine_dies_without_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "elsewhere")
    theirs = Claims(tmp_path)
    assert theirs.take("run")
    monkeypatch.undo()
    mine = Claims(tmp_path)
    assert not mine.take("run")
    long_ago = (tmp_path / "run").stat().st_mtime - STALE_AFTER - 1
    os.utime(tmp_path / "run", (long_ago, long_ago))
    assert mine.take("run")
    theirs.release("run")  # it is no longer theirs to give back
    assert (tmp_path / "run").exists()
