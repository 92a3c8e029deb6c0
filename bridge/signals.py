# SPDX-License-Identifier: GPL-3.0-or-later
"""What asks a program to end in its own way: by a key, by another program, or at a limit."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

#: CTRL-C; what a cluster or a container sends before it kills; CTRL-BREAK on Windows, with which programs end
#: programs; the end of the terminal; the limit of CPU time (``ulimit -t``), once a second until it kills.
NAMES = ("SIGINT", "SIGTERM", "SIGBREAK", "SIGHUP", "SIGXCPU")
#: Of these nobody wants more than the first: they do not ask a second time to end at once.
UNREPEATED = ("SIGHUP", "SIGXCPU")
#: Seconds of CPU time between the signal and the kill, where the limit leaves none (``ulimit -t`` sets both).
TIME_TO_SAVE = 10

Handler = Callable[[signal.Signals], None]


def catch(handle: Handler) -> dict[signal.Signals, Any]:
    """Call ``handle`` where a signal asks to end; whose they were. Nothing outside the main thread.

    A program that is started by ``nohup`` stays deaf to the end of its terminal.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    heard: set[int] = set()

    def hear(number: int, _: FrameType | None) -> None:
        known = signal.Signals(number)
        if not (heard and known.name in UNREPEATED):
            heard.add(number)
            handle(known)

    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    numbers = [each for each in numbers if each.name != "SIGHUP" or signal.getsignal(each) != signal.SIG_IGN]
    _leave_time_to_save()
    return {number: signal.signal(number, hear) for number in numbers}


@contextmanager
def caught(handle: Handler) -> Iterator[None]:
    """``catch``, for as long as the context lasts."""
    former = catch(handle)
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def interrupt(_: signal.Signals) -> None:
    """A handler: any of them does what CTRL-C does, so that nothing is left half done."""
    raise KeyboardInterrupt


def _leave_time_to_save() -> None:
    if sys.platform == "win32":  # which has no such limits
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if hard != resource.RLIM_INFINITY and (soft == resource.RLIM_INFINITY or soft > hard - TIME_TO_SAVE):
        resource.setrlimit(resource.RLIMIT_CPU, (max(1, hard - TIME_TO_SAVE), hard))
