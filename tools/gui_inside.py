#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The first process of a GUI test's own room of processes (tools/gui_test.py starts it, inside the chroot).

    gui_inside.py SECONDS LEFT_FILE COMMAND …

Runs the command, ends it where it takes longer than it may on a machine that is so busy, and then lists in
``LEFT_FILE`` what it has left running. Whatever that is ends with this process: the kernel sees to it.
Standard library only: the chroot has no more.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

#: Seconds, on an idle machine, in which what a window began may end after it.
ENDING_SECONDS = 10.0
#: Seconds between looks.
LOOK_SECONDS = 0.1


def slowness() -> float:
    """How many times longer things take than on an idle machine: by who wants to run, for each core."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


class Patience:
    """A time that is over after so many seconds of an idle machine."""

    def __init__(self, seconds: float) -> None:
        self._left, self._looked = seconds, time.monotonic()

    @property
    def is_over(self) -> bool:
        now = time.monotonic()
        self._left -= (now - self._looked) / slowness()
        self._looked = now
        return self._left <= 0.0


def others() -> dict[int, str]:
    """The command lines of all processes of this room but this one and zombies.

    One that is just becoming another program has none for a moment: it is known by its name.
    """
    found = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            try:
                words = (folder / "cmdline").read_bytes().split(b"\0")
                before, _, after = (folder / "stat").read_bytes().rpartition(b")")
            except OSError:  # it has ended meanwhile
                continue
            if after.split()[:1] not in ([b"Z"], [b"X"]):
                line = " ".join(os.fsdecode(word) for word in words).strip()
                found[int(folder.name)] = line or os.fsdecode(before.partition(b"(")[2])
    return found


def reap() -> None:
    """Take in how orphans ended, which are the first process's own."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        pass


def run(seconds: float, left: Path, command: list[str]) -> int:
    patience = Patience(seconds)
    process = subprocess.Popen(command, start_new_session=True)
    while process.poll() is None and not patience.is_over:
        time.sleep(LOOK_SECONDS)
    status = process.returncode
    if status is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    ending = Patience(ENDING_SECONDS)
    reap()
    while others() and not ending.is_over and status is not None:
        time.sleep(LOOK_SECONDS)
        reap()
    left.write_text("".join(f"{line}\n" for line in others().values()), encoding="utf-8")
    return 124 if status is None else status


if __name__ == "__main__":
    sys.exit(run(float(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]))
