# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports ``physhdr`` once and forks a process for each command that is asked for on stdin.

Importing torch takes seconds of a busy core, as often as a short torture starts a command. What is forked is
a process like any other: it has its own group, can be killed, holds its own locks.
"""

import atexit
import json
import os
import selectors
import signal
import sys
import threading
import traceback
from typing import Any

from processes import ROOT, die_with_parent


def main() -> int:
    from physhdr.backend.cli import _command

    _command(["inspect", "x"])  # imports all commands and their parser
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    look, wake = os.pipe()
    for end in (look, wake):
        os.set_blocking(end, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake)
    waiting = selectors.DefaultSelector()
    waiting.register(0, selectors.EVENT_READ)
    waiting.register(look, selectors.EVENT_READ)
    running: dict[int, int] = {}
    pending = b""
    while True:
        ready = [key.fd for key, _ in waiting.select(1.0)]
        if look in ready:
            os.read(look, 4096)
        _reap(running, answers)
        if 0 not in ready:
            continue
        some = os.read(0, 65536)
        if not some:
            break
        *lines, pending = (pending + some).split(b"\n")
        for line in lines:
            asked = json.loads(line)
            answers.flush()
            pid = os.fork()
            if pid == 0:
                _become(asked)
            os.setpgid(pid, pid)
            running[pid] = asked["number"]
            print(json.dumps({"number": asked["number"], "pid": pid}), file=answers, flush=True)
    for pid in running:
        os.killpg(pid, signal.SIGKILL)
    return 0


def _reap(running: dict[int, int], answers: Any) -> None:
    for pid in list(running):
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            ended = {"number": running.pop(pid), "status": os.waitstatus_to_exitcode(status)}
            print(json.dumps(ended), file=answers, flush=True)


def _become(asked: dict[str, Any]) -> None:
    """The command, to its end; never returns."""
    from physhdr.backend.cli import main as physhdr

    os.setpgid(0, 0)
    die_with_parent()
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    output = os.open(asked["log"], os.O_WRONLY | os.O_APPEND)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for ours, theirs in ((nothing, 0), (output, 1), (output, 2)):
        os.dup2(ours, theirs)
    os.chdir(ROOT)
    sys.argv = ["physhdr", *asked["arguments"]]
    status = 1
    try:
        status = physhdr(asked["arguments"])
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:  # noqa: BLE001 (what the interpreter does with what nobody catches)
        traceback.print_exc()
    finally:
        threading._shutdown()  # pyright: ignore[reportAttributeAccessIssue] (it is no public name)
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
