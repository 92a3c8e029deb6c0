# SPDX-License-Identifier: GPL-3.0-or-later
"""The session with real files and processes, without Blender: what it writes, and what it does not trust."""

import errno
import os
import signal
import stat
import subprocess
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from physhdr.addon.session.advice import problem_of
from physhdr.addon.session.process import kill
from physhdr.addon.session.session import CHOICE_FILE, LOG_FILE, Session, read_choice, write_choice
from physhdr.addon.session.state import KeepReport, LinkLost, PythonChosen, Received
from physhdr.bridge.connection import (
    LOCK_FILE,
    Connection,
    new_token,
    private_home,
    write_connection,
)
from physhdr.bridge.errors import OutputError
from physhdr.bridge.lock import Lock
from physhdr.bridge.messages import PROTOCOL_VERSION, Failure, JobStatus, Shutdown, StatusGet, WhenClosed

REPORT = {"versions": {"torch": "2.13.0"}}


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def open_umask():
    """As a system has it on which everybody may write everywhere."""
    before = os.umask(0)
    yield
    os.umask(before)


@pytest.fixture
def launcher(tmp_path):
    """Stands in for the backend: says something and ends."""
    path = tmp_path / "launch.py"
    path.write_text("raise SystemExit('no torch')")
    return path


def ask_for_a_backend(home, launcher):
    """The session after its backend has ended, or was not even started."""
    session = Session(home, launcher)
    session.dispatch(PythonChosen(sys.executable, REPORT))
    session.ask(StatusGet())
    assert session.wait(lambda state: state.link.status == "off", 30.0)
    return session


@pytest.mark.skipif(
    not hasattr(os, "waitid"), reason="processes that ended and were not waited for are POSIX's"
)
def test_a_killed_backend_is_not_taken_for_one_that_runs(tmp_path, launcher):
    """Its connection file is there still, and its process until somebody asks how it ended."""
    session = Session(tmp_path / "home", launcher)
    private_home(tmp_path / "home")
    killed = subprocess.Popen([sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"])
    os.waitid(os.P_PID, killed.pid, os.WEXITED | os.WNOWAIT)
    session._process = killed
    token = new_token()
    write_connection(tmp_path / "home", Connection(PROTOCOL_VERSION, 9, token, killed.pid, "1", "log"))
    session.dispatch(PythonChosen(sys.executable, REPORT))
    session.ask(StatusGet())
    assert session.wait(lambda state: state.link.status == "off", 30.0)
    assert "no torch" in problem_of(session.state).message  # what the new one said


@pytest.fixture
def bystander():
    """Another program of the user's, that leads a group of processes as a backend does."""
    with subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True
    ) as one:
        yield one
        one.kill()


def test_a_program_that_has_the_number_of_a_backend_that_is_gone_is_none(tmp_path, launcher, bystander):
    """After a power cut the connection file is there still, and its process number another program's."""
    session = left_behind(tmp_path / "home", launcher, bystander.pid)
    session.ask(StatusGet())
    assert session.wait(lambda state: state.link.status == "off", 30.0)
    assert "no torch" in problem_of(session.state).message  # one was started, which said so
    assert session.state.link.pid == 0
    session._looked = 0.0
    session.pump()
    assert session.state.link.status == "off"


def test_only_a_backend_that_lives_is_ended(tmp_path, launcher, bystander):
    """Found while it held the home's lock, which it does not any more when the user presses *End It*."""
    home = tmp_path / "home"
    session = left_behind(home, launcher, bystander.pid)
    lock = Lock(home / LOCK_FILE)
    assert lock.take()
    session._look()
    assert session.wait(lambda state: state.link.status == "off", 30.0)
    assert session.state.link.pid == bystander.pid  # it does not answer
    lock.release()
    session.ask(Shutdown())
    session.ask(Shutdown())  # at once
    with pytest.raises(subprocess.TimeoutExpired):
        bystander.wait(0.3)
    # As long as it holds the lock, and is the one that its file names, it is ended.
    assert lock.take()
    session._end(bystander.pid + 1, kill)
    session._end(bystander.pid, kill)
    assert bystander.wait(10) == -9
    lock.release()


#: What a backend of another version answers to hello.
NOT_TAKEN = LinkLost("it speaks another version", refusal=Failure(code="wrong_protocol", message="version 3"))
#: Says when it can be asked to end, and what it does then.
SAVES = """
import signal, sys, time
def end(*_):
    print("saved", flush=True)
    sys.exit(7)
signal.signal(signal.SIGTERM, end)
print("ready", flush=True)
time.sleep(60)
"""


@contextmanager
def unheard(home, launcher, backend):
    """A session that has found a backend which holds the home's lock, and nobody listens."""
    if backend.stdout:
        assert backend.stdout.readline() == "ready\n"
    session = left_behind(home, launcher, backend.pid)
    lock = Lock(home / LOCK_FILE)
    assert lock.take()
    session._look()
    assert session.wait(lambda state: state.link.status == "off", 30.0)
    assert session.state.link.pid == backend.pid
    yield session
    lock.release()


@pytest.fixture
def saves():
    """A program of this process's own group, as one that a user's shell has started."""
    with subprocess.Popen([sys.executable, "-c", SAVES], stdout=subprocess.PIPE, text=True) as one:
        yield one
        one.kill()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGTERM")
def test_a_backend_of_another_version_may_save_before_it_ends(tmp_path, launcher, saves):
    with unheard(tmp_path / "home", launcher, saves) as session:
        session.dispatch(NOT_TAKEN)
        session.ask(Shutdown())
        assert saves.wait(10) == 7 and saves.stdout.read() == "saved\n"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGSTOP")
def test_one_of_another_version_that_hangs_is_killed_when_its_time_is_over(tmp_path, launcher, saves):
    with unheard(tmp_path / "home", launcher, saves) as session:
        session.dispatch(NOT_TAKEN)
        saves.send_signal(signal.SIGSTOP)
        session.ask(Shutdown())
        session.pump()
        assert saves.poll() is None
        session._to_kill = saves.pid, 0.0
        session.pump()
        assert saves.wait(10) == -signal.SIGKILL


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGSTOP")
def test_a_backend_that_does_not_answer_is_ended_at_once(tmp_path, launcher, saves):
    """It alone, whatever group it is in: here that of this very test."""
    with unheard(tmp_path / "home", launcher, saves) as session:
        saves.send_signal(signal.SIGSTOP)
        session.ask(Shutdown())
        session.pump()
        assert saves.wait(10) == -signal.SIGKILL


def test_what_the_system_does_not_let_us_end_is_told(tmp_path, launcher, bystander):
    def refuse(pid):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    with unheard(tmp_path / "home", launcher, bystander) as session:
        session._end(bystander.pid, refuse)
        assert f"{bystander.pid} cannot be ended: Operation not" in problem_of(session.state).message


class Heard:
    """Stands in for the connection: what has come, and what was sent."""

    def __init__(self):
        self.events, self.sent = [], []
        self.send = self.sent.append

    def take(self):
        events, self.events = self.events, []
        return events

    def close(self):
        pass


def test_who_comes_into_control_says_what_becomes_of_a_training(tmp_path, launcher):
    """At once, when another leaves, and when it is taken; one that only watches would be refused."""
    session = Session(tmp_path, launcher)
    session.when_closed = WhenClosed(training="stop")
    session._client = client = Heard()

    def told(*in_control):
        client.sent.clear()
        client.events += [Received(JobStatus(in_control=each)) for each in in_control]
        session.pump()
        return [each for each in client.sent if isinstance(each, WhenClosed)]

    assert told(False, False) == []
    assert told(True) == told(False, True) == [session.when_closed]
    session.set_when_closed(WhenClosed(training="keep"))
    assert client.sent[-1] == WhenClosed(training="keep")
    assert told(True) == []


def left_behind(home, launcher, pid):
    """A session that finds the connection file of a backend ``pid``, where nobody listens."""
    private_home(home)
    write_connection(home, Connection(PROTOCOL_VERSION, 9, new_token(), pid, "1", "log"))
    session = Session(home, launcher)
    session.dispatch(PythonChosen(sys.executable, REPORT))
    return session


@pytest.mark.parametrize("found", [None, 0o666])
def test_the_home_and_its_logs_are_their_owners_alone(tmp_path, launcher, open_umask, found):
    home = tmp_path / "home"
    logs = [home / LOG_FILE, home / "install.log"]
    if found:
        home.mkdir()
        for log in logs:
            log.touch()
            log.chmod(found)
    session = ask_for_a_backend(home, launcher)
    assert "no torch" in problem_of(session.state).message
    session.start_task("install", [sys.executable, "-c", "print('fetched')"], home / "install.log")
    assert session.wait(lambda state: not state.tasks, 30.0)
    assert mode(home) == 0o700 and [mode(log) for log in logs] == [0o600, 0o600]
    assert "no torch" in logs[0].read_text() and "fetched" in logs[1].read_text()


def test_a_home_that_cannot_be_closed_to_others_is_told(tmp_path, launcher):
    everybodys = tmp_path / "tmp"
    everybodys.mkdir()
    everybodys.chmod(0o1777)
    problem = problem_of(ask_for_a_backend(everybodys, launcher).state)
    assert f"{everybodys} is open to other users" in problem.message
    assert f"say {everybodys / 'physhdr'}" in problem.message  # the remedy
    with pytest.raises(OutputError, match="open to other users"):
        Session(everybodys, launcher).start_task("install", [sys.executable], everybodys / "install.log")
    assert list(everybodys.iterdir()) == [] and mode(everybodys) == 0o1777


def test_a_python_that_another_user_wrote_down_is_not_run(tmp_path, monkeypatch):
    kept = KeepReport(sys.executable, REPORT)
    write_choice(tmp_path / CHOICE_FILE, kept)
    assert read_choice(tmp_path / CHOICE_FILE) == PythonChosen(sys.executable, REPORT)
    real = os.fstat
    monkeypatch.setattr(os, "fstat", lambda number: SimpleNamespace(**_of_another(real(number))))
    assert read_choice(tmp_path / CHOICE_FILE) == PythonChosen("")


def _of_another(found):
    fields = {name: getattr(found, name) for name in dir(found) if name.startswith("st_")}
    return {**fields, "st_uid": os.geteuid() + 4711}


def test_a_path_that_the_system_refuses_is_a_problem_of_the_data_set(tmp_path, launcher):
    session = Session(tmp_path, launcher)
    folder = str(tmp_path / ("x" * 300))
    session.choose_dataset(folder)
    assert session.wait(lambda state: state.dataset.problem is not None, 60.0)
    problem = session.state.dataset.problem
    assert folder in problem.message and "too long" in problem.message and problem.hint
