# SPDX-License-Identifier: GPL-3.0-or-later
"""CTRL-C while Blender renders: raised afterwards, because within Cycles' own Python it would be lost."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

NAMES = ("SIGINT", "SIGBREAK")  # the latter is CTRL-BREAK on Windows, with which programs end programs


def signals() -> list[signal.Signals]:
    """Those of ``NAMES`` that this system has."""
    return [getattr(signal, name) for name in NAMES if hasattr(signal, name)]


@contextmanager
def held() -> Iterator[None]:
    """Note an interrupt instead of raising it; ``KeyboardInterrupt`` on the way out if there was one.

    Measured: raised in the middle of a frame, Cycles' callback prints it, and the run continues as if nothing
    had been. Nothing happens outside the main thread, which alone gets signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noted = []
    former = {each: signal.signal(each, lambda number, _: noted.append(number)) for each in signals()}
    try:
        yield
    finally:
        for each, handler in former.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)
    if noted:
        raise KeyboardInterrupt
