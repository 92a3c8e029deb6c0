# SPDX-License-Identifier: GPL-3.0-or-later
"""The home folder: one backend in it, and nobody but its owner can keep that one out."""

import errno
import fcntl
import os
import stat
import subprocess
import sys
import threading

import pytest

from physhdr.backend.serve.failures import BusyError
from physhdr.backend.serve.home import own_home
from physhdr.bridge.connection import CONNECTION_FILE, LOCK_FILE
from physhdr.bridge.errors import OutputError
from physhdr.bridge.lock import Lock

#: Takes the lock, and keeps it until its stdin ends.
HOLDER = """
import fcntl, sys
file = open(sys.argv[1], "a")
fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
print("held", flush=True)
sys.stdin.read()
"""


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("found", [None, 0o644, 0o666])
def test_the_lock_is_its_owners_alone(tmp_path, found):
    """Whoever may open a file may lock it: 0600 in 0700, also where it was 0644 in 0755."""
    home = tmp_path / "home"
    if found:
        home.mkdir()
        (home / LOCK_FILE).touch()
        (home / LOCK_FILE).chmod(found)
        home.chmod(0o755)
    before = os.umask(0)
    try:
        with own_home(home):
            assert mode(home) == 0o700 and mode(home / LOCK_FILE) == 0o600
    finally:
        os.umask(before)


def test_one_at_a_time_and_a_stale_connection_is_removed(tmp_path):
    with own_home(tmp_path):
        (tmp_path / CONNECTION_FILE).write_text("stale")
        with pytest.raises(BusyError, match="already serves"), own_home(tmp_path):
            pass
        assert (tmp_path / CONNECTION_FILE).exists()  # a second one leaves the first one's alone
    with own_home(tmp_path):
        assert not (tmp_path / CONNECTION_FILE).exists()


def test_it_keeps_out_and_is_kept_out_by_an_earlier_version(tmp_path):
    """Both lock the same file in the same way, and a killed one leaves nothing behind."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / LOCK_FILE)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(BusyError), own_home(tmp_path):
            pass
        holder.kill()
        holder.wait(10)
    with own_home(tmp_path):
        refused = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60
        )
        assert refused.returncode == 1 and "BlockingIOError" in refused.stderr


def test_who_looks_for_a_backend_does_not_keep_one_out(tmp_path):
    """A Blender that looks whether a connection file was left behind has the lock for a moment."""
    look = Lock(tmp_path / LOCK_FILE)
    assert look.take()
    threading.Timer(0.1, look.release).start()
    with own_home(tmp_path):
        assert not Lock(tmp_path / LOCK_FILE).take()


def test_a_lock_that_leads_elsewhere_is_not_followed(tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "mine").chmod(0o644)
    (tmp_path / LOCK_FILE).symlink_to(tmp_path / "mine")
    with pytest.raises(OutputError, match=r"backend\.lock cannot be locked"), own_home(tmp_path):
        pass
    assert mode(tmp_path / "mine") == 0o644 and (tmp_path / "mine").read_text() == "mine"


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_disk_without_locks_is_told(tmp_path, monkeypatch, recwarn, number):
    """As some network file systems are; a lock that a killed process would leave behind is none."""

    def refuse(file, operation):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(OutputError, match=r"cannot be locked[\s\S]*disk of this machine"), own_home(tmp_path):
        pass
    monkeypatch.undo()
    with own_home(tmp_path):  # nothing is left that would be in the way
        pass
