# SPDX-License-Identifier: GPL-3.0-or-later
"""Of several who want the same, one gets it; the dead hold nothing, and who stands still keeps it."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import filelock
import pytest

from physhdr.bridge.errors import OutputError
from physhdr.bridge.lock import Claims, Lock, LocksRefusedError

TAKES = """
    import sys, time
    from pathlib import Path
    from physhdr.bridge.lock import Claims
    claims = Claims(Path(sys.argv[1]), print)
    print(claims.take("run"), flush=True)
    time.sleep(60)
"""


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "data" / ".claims"


@pytest.fixture
def another(folder):
    """A process that holds the claim ``run``."""
    command = [sys.executable, "-c", textwrap.dedent(TAKES), str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "True\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def claims(folder):
    return Claims(folder, pytest.fail)


def test_one_of_many_gets_it(folder):
    """Sixteen owners race for each of forty jobs."""
    owners = [claims(folder) for _ in range(16)]
    barrier = threading.Barrier(16)

    def want(owner, job):
        barrier.wait()
        return owner.take(job)

    with ThreadPoolExecutor(16) as pool:
        for k in range(40):
            assert sum(pool.map(lambda owner, job=f"run_{k}": want(owner, job), owners)) == 1
    for owner in owners:
        owner.__exit__()
    assert not folder.exists()  # nothing is left behind


def test_what_is_held_is_seen_and_given_back(folder):
    other = claims(folder)
    with claims(folder) as mine:
        assert mine.take("run") and not other.take("run") and not mine.take("run")
        assert other.is_taken("run") and not mine.is_taken("run")
        other.release("run")  # not its own: nothing happens
        assert not other.take("run") and other.is_taken("run")
        mine.release("run")
        assert not other.is_taken("run") and other.take("run") and mine.is_taken("run")
        other.release("run")
        assert mine.take("run")
    assert not other.is_taken("run") and not folder.exists()
    assert other.take("run")  # the folder is made again


def test_a_killed_process_holds_nothing(folder, another):
    with claims(folder) as mine:
        assert mine.is_taken("run") and not mine.take("run")
        another.send_signal(signal.SIGKILL)
        os.waitid(os.P_PID, another.pid, os.WEXITED | os.WNOWAIT)  # dead, though not yet missed
        assert not mine.is_taken("run") and mine.take("run")
    assert not folder.exists()


def test_a_process_that_stands_still_keeps_its_claim(folder, another):
    """CTRL-Z stops a command; its jobs, in sessions of their own, go on."""
    another.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, another.pid, os.WSTOPPED | os.WNOWAIT)
    assert not claims(folder).take("run")


def test_the_last_to_go_tidies_after_the_dead_and_leaves_the_living(folder, another):
    with claims(folder) as mine:
        for name in ("done", ".other"):  # a dead one's, and somebody's
            (folder / name).touch()
        assert mine.take("mine")
    assert os.listdir(folder) == ["run"]
    another.kill()
    another.wait()
    with claims(folder):
        pass
    assert not folder.exists()


def test_who_gives_back_leaves_the_file_that_another_put_there(folder):
    """Somebody deleted the folder while the claim was held."""
    mine, theirs = claims(folder), claims(folder)
    assert mine.take("run")
    (folder / "run").unlink()
    assert theirs.take("run")
    mine.release("run")
    assert (folder / "run").exists() and not mine.take("run")


def test_those_who_begin_while_others_end_meet_no_missing_folder(folder):
    def come_and_go(k):
        for _ in range(60):
            with claims(folder) as mine:
                while not mine.take(f"run_{k}"):
                    assert time.monotonic() < deadline

    deadline = time.monotonic() + 60
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(come_and_go, range(8)))
    assert not folder.exists()


def test_a_folder_that_was_gone_for_a_moment_is_not_a_disk_without_locks(folder, monkeypatch):
    """One ends and removes the folder, another makes it again and, tidying up, the file of the same name."""
    acquire = filelock.FileLock.acquire
    calls = []

    def gone_for_a_moment(lock, **arguments):
        calls.append(lock)
        if len(calls) > 1:
            return acquire(lock, **arguments)
        Path(lock.lock_file).touch()
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(filelock.FileLock, "acquire", gone_for_a_moment)
    with claims(folder) as mine:
        assert mine.take("run") and len(calls) == 2
        assert mine.keep_others_out and (folder / "run").exists()


def test_a_lock_whose_file_was_removed_meanwhile_is_not_taken(tmp_path, monkeypatch):
    """As by filelock on Windows, which unlocks first and then removes the file that another has locked."""

    def acquire(lock, **_):
        Path(lock.lock_file).unlink(missing_ok=True)

    path = tmp_path / "a"
    with monkeypatch.context() as removed:
        removed.setattr(filelock.FileLock, "acquire", acquire)
        assert not Lock(path).take()
    lock = Lock(path)
    assert lock.take() and path.exists()
    lock.release()


@pytest.fixture
def no_locks(monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_):
        raise OSError(38, "Function not implemented")  # ENOSYS

    monkeypatch.setattr(fcntl, "flock", refuse)


def test_where_a_disk_knows_no_locks_there_is_a_word_and_no_lock(folder, no_locks):
    said = []
    with Claims(folder, said.append) as one, Claims(folder, said.append) as two:
        assert one.keep_others_out
        assert one.take("run") and one.take("more") and two.take("run")
        assert not one.keep_others_out and not two.keep_others_out
        assert not one.is_taken("run") and not one.take("run")  # it has it, as far as there is such a thing
        one.release("run")
        assert one.take("run")
    assert len(said) == 2 and not folder.exists()
    assert (
        said[0]
        == said[1]
        == (f"{folder.parent} cannot be locked (Function not implemented): do not work there twice at once")
    )


def test_a_python_without_the_library_is_told_of_as_such_a_disk_is(tmp_path, monkeypatch):
    """A Blender in which the extension is not installed."""
    monkeypatch.setitem(sys.modules, "filelock", None)
    with pytest.raises(LocksRefusedError, match="no filelock"):
        Lock(tmp_path / "lock").take()
    said = []
    with Claims(tmp_path / "claims", said.append) as mine:
        assert mine.take("run")
    assert len(said) == 1 and not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_is_one_clear_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write claims into"):
        claims(tmp_path / "file").take("run")
    with pytest.raises(OutputError, match="cannot write claims into"):
        claims(tmp_path / "file" / "claims").take("run")
    with pytest.raises(OutputError, match=r"cannot write to .*none"):
        Lock(tmp_path / "file" / "none" / "lock").take()


def test_a_lock_is_waited_for(tmp_path):
    mine, theirs = Lock(tmp_path / "lock"), Lock(tmp_path / "lock")
    assert theirs.take() and not mine.take(wait=0.1)
    timer = threading.Timer(0.2, theirs.release)
    timer.start()
    assert mine.take(wait=20)
    timer.join()
    mine.release()
    mine.release()  # once is enough
    assert not list(tmp_path.iterdir())
