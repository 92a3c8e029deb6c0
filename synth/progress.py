# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress as plain text: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

BAR = 24
LINES = 12  # about so many a step where the output is no terminal


class Progress:
    """Counts the items of one step and says how long the rest will take."""

    def __init__(self, what: str, total: int, stream: TextIO | None = None) -> None:
        self.what, self.total, self.done = what, total, 0
        self.stream = stream or sys.stdout
        self.began = time.monotonic()
        self.every = 1 if self.stream.isatty() else max(1, total // LINES)

    def advance(self, note: str = "") -> None:
        """One more item is done."""
        self.done += 1
        if self.done % self.every and self.done != self.total:
            return
        spent = time.monotonic() - self.began
        left = spent / self.done * (self.total - self.done)
        filled = BAR * self.done // self.total
        bar = "#" * filled + "-" * (BAR - filled)
        line = f"{self.what} [{bar}] {self.done}/{self.total}  {spent:.0f} s, {left:.0f} s left  {note}"
        if self.stream.isatty():
            self.stream.write(f"\r\x1b[K{line}" + ("\n" if self.done == self.total else ""))
        else:
            self.stream.write(line.rstrip() + "\n")
        self.stream.flush()


def say(line: str) -> None:
    """One line of report."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


@contextmanager
def quiet() -> Iterator[None]:
    """Keep what Blender itself writes (saved files, devices) off the process's stdout; errors still raise."""
    sys.stdout.flush()
    kept = os.dup(1)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(sink)
