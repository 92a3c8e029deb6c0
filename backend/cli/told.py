# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a command is, for people on a bar, for a program as JSON on stdout, an object a line (``--json``).

What such lines say is what Blender's panel reads of a child process (``addon/session/task.py``).
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.progress import Progress

from ..runs.terminal import console

#: Called with how many are done, of how many, and what is worked on.
Told = Callable[[int, int, str], None]
#: Shows people a sentence, or a table of rich's.
Say = Callable[[Any], None]
#: Seconds between two lines.
BETWEEN = 0.2


def line(**content: Any) -> None:
    """One object, at once."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def answered(work: Callable[[], dict[str, Any]], as_json: bool) -> int:
    """Do the ``work``; the exit status. With ``as_json`` its result is the last line.

    What it raises is told by ``main``, by the same rule for every command.
    """
    result = work()
    if as_json:
        line(result=result)
    return 0


def saying(as_json: bool) -> Say:
    """What people are told by; with ``as_json`` it is silent, for stdout is the program's."""
    return _nothing if as_json else _show


def _nothing(_: Any) -> None: ...


def _show(what: Any) -> None:
    console.print(what)


@contextmanager
def progress(what: str, unit: str, as_json: bool) -> Iterator[Told]:
    """Shows how far ``what`` is, counted in ``unit``, for as long as the context lasts."""
    if as_json:
        yield _Lines(unit)
        return
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)

        def show(done: int, total: int, part: str) -> None:
            bar.update(task, completed=done, total=total, description=f"{what} {part}".strip())

        yield show


class _Lines:
    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._begun = time.monotonic()
        self._last = 0.0

    def __call__(self, done: int, total: int, part: str) -> None:
        now = time.monotonic()
        if now < self._last + BETWEEN and done < total:
            return
        self._last = now
        left = {"seconds_left": (now - self._begun) / done * (total - done)} if done else {}
        line(progress=done / total if total else 0.0, message=f"{self._unit} {done} of {total}", **left)
