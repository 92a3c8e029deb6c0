# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that is run to its end, or ended with all that it started."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import psutil

#: Seconds between looks at whether to go on; and those that a process has to end by itself.
LOOK_EVERY, GRACE = 0.2, 5.0
#: Libraries read these where ``set_threads`` does not reach.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PR_SET_PDEATHSIG = 1  # Linux, prctl(2)


class StoppedError(Exception):
    """Somebody wants the work to end."""


def run_to_end(
    command: Sequence[str],
    log: Path,
    should_stop: Callable[[], bool],
    environment: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> int:
    """Run a command, what it says appended to ``log``; its exit status.

    ``environment``: added to this process's. ``folder``: where it runs. Raises ``StoppedError`` when
    ``should_stop`` says so; whatever is raised, the process and what it started have ended.
    """
    with open(log, "ab") as output:
        # A session of its own: CTRL-C in the terminal is ours alone.
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, **(environment or {})},
            cwd=folder,
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # the same for Windows
        )
    try:
        while process.poll() is None:
            if should_stop():
                raise StoppedError
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_EVERY)
    finally:
        if process.poll() is None:
            _end(process)
    if should_stop():
        raise StoppedError
    return process.returncode


def run_in_front(command: Sequence[str]) -> int:
    """Run a command that speaks for itself on this terminal; its exit status.

    Whatever is raised meanwhile, the process and what it started have ended.
    """
    process = subprocess.Popen(command)
    try:
        return process.wait()
    finally:
        if process.poll() is None:
            _end(process)


def end_with_parent() -> None:
    """From now on this process is ended politely when the one that started it dies (Linux)."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and what it started: politely, then by force."""
    family: list[psutil.Process] = []
    for how in (psutil.Process.terminate, psutil.Process.kill):
        with suppress(psutil.NoSuchProcess):
            first = psutil.Process(process.pid)
            family = [*{*family, first, *first.children(recursive=True)}]
        for each in family:
            with suppress(psutil.Error):
                how(each)
        _, family = psutil.wait_procs(family, GRACE)
        if not family:
            break
    process.wait()
