# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs that are started to be killed: a process group each, which does not outlive this tool."""

import ctypes
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
BIN = ROOT / ".venvs" / "backend" / "bin"
BLENDER = ROOT / ".venvs" / "run-blender"
#: prctl(2): the signal that a process gets when who started it is gone.
PR_SET_PDEATHSIG = 1
#: Seconds between looks at a program that is waited for.
LOOK_EVERY = 0.02


class StuckError(Exception):
    """A program did not end in time."""


def die_with_parent() -> None:
    """In a child, before it becomes another program: end when this tool is killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class Program:
    """A command that runs in a process group of its own; its output is appended to ``log``."""

    def __init__(self, words: list[object], log: Path) -> None:
        self.words, self.log = [str(word) for word in words], log
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(log, "ab") as file:
            file.write(f"$ {' '.join(self.words)}\n".encode())
            file.flush()
            self._from = file.tell()
            self.started = time.time()
            self._begin(file.fileno())

    def _begin(self, output: int) -> None:
        self._process = subprocess.Popen(
            self.words,
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=die_with_parent,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        self.pid = self._process.pid

    def poll(self) -> int | None:
        """The exit status (−9: killed), or None while it runs."""
        return self._process.poll()

    def output(self) -> str:
        """What it has printed so far."""
        with open(self.log, "rb") as file:
            file.seek(self._from)
            return file.read().decode("utf-8", "replace")

    def until(self, condition: Callable[[], bool], timeout: float, every: float = LOOK_EVERY) -> bool:
        """Wait for the condition; False if the program or the time ended before it held."""
        deadline = time.monotonic() + timeout
        while not condition():
            if self.poll() is not None or time.monotonic() > deadline:
                return False
            time.sleep(every)
        return True

    def wait(self, timeout: float) -> int:
        """Its exit status; raises ``StuckError`` after ``timeout`` seconds, and it is killed."""
        self.until(lambda: False, timeout)
        status = self.poll()
        if status is None:
            self.kill()
            raise StuckError(f"not ended after {timeout:.0f} s: {' '.join(self.words)}")
        return status

    def kill(self, *, group: bool = True) -> bool:
        """SIGKILL to the group (or the first process alone); whether it had not ended by itself before."""
        ran = self.poll() is None
        with suppress(ProcessLookupError):
            if group:
                os.killpg(self.pid, signal.SIGKILL)
            elif ran:
                os.kill(self.pid, signal.SIGKILL)
        deadline = time.monotonic() + 30.0
        while self.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
        return ran and self.poll() == -signal.SIGKILL

    @contextmanager
    def held(self) -> Iterator[None]:
        """Within it, the program stands still (SIGSTOP); it keeps its files and locks."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            with suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGCONT)

    def interrupt(self) -> None:
        """CTRL-C."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGINT)


class WarmProgram(Program):
    """A ``physhdr`` command forked from a process that has imported it: the same code, seconds earlier."""

    def __init__(self, warm: "Warm", words: list[object], log: Path) -> None:
        self._warm = warm
        super().__init__(words, log)

    def _begin(self, output: int) -> None:
        self._number, self.pid = self._warm.fork(self.words[1:], self.log)

    def poll(self) -> int | None:
        return self._warm.ended.get(self._number)


class Warm:
    """The process that has imported ``physhdr`` (``warm.py``) and forks commands. A context manager."""

    def __init__(self) -> None:
        self.ended: dict[int, int] = {}
        self._pids: dict[int, int] = {}
        self._numbers = itertools.count()
        self._told = threading.Condition()
        self._process = subprocess.Popen(
            [str(BIN / "python"), str(Path(__file__).with_name("warm.py"))],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=die_with_parent,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        self._reader = threading.Thread(target=self._read, name="warm", daemon=True)
        self._reader.start()

    def __enter__(self) -> "Warm":
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait(30)

    def _read(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            answer = json.loads(line)
            with self._told:
                if "status" in answer:
                    self.ended[answer["number"]] = answer["status"]
                else:
                    self._pids[answer["number"]] = answer["pid"]
                self._told.notify_all()

    def fork(self, arguments: list[str], log: Path) -> tuple[int, int]:
        """(number, process id) of the command that begins."""
        assert self._process.stdin
        with self._told:
            number = next(self._numbers)
            self._process.stdin.write(
                json.dumps({"number": number, "arguments": arguments, "log": str(log)}) + "\n"
            )
            self._process.stdin.flush()
            if not self._told.wait_for(lambda: number in self._pids, 120.0):
                raise StuckError("the process that forks commands does not answer")
            return number, self._pids[number]
