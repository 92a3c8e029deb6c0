# SPDX-License-Identifier: GPL-3.0-or-later
"""A command's output: text and progress bars for people, or a JSON object per line for programs (``--json``).

Blender's panel reads these lines from its child processes (``addon/session/task.py``).
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.progress import Progress

from ..runs.terminal import console

#: Called with the number done, the total, and the item in progress.
ShowProgress = Callable[[int, int, str], None]
#: Prints a sentence or a rich table.
Say = Callable[[Any], None]
#: Minimum time between two progress lines.
SECONDS_BETWEEN_LINES = 0.2


def write_json(**content: Any) -> None:
    """Write one object as a line and flush."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def run_and_report(work: Callable[[], dict[str, Any]], as_json: bool) -> int:
    """Do the ``work``; returns the exit status. With ``as_json``, its result is the last line.

    ``main`` reports errors, in the same way for every command.
    """
    result = work()
    if as_json:
        write_json(result=result)
    return 0


def printer(as_json: bool) -> Say:
    """Prints to the terminal; silent with ``as_json``, because stdout is then read by a program."""
    return _nothing if as_json else _show


def _nothing(_: Any) -> None: ...


def _show(what: Any) -> None:
    console.print(what)


@contextmanager
def progress(what: str, unit: str, as_json: bool) -> Iterator[ShowProgress]:
    """Shows the progress of ``what``, counted in ``unit``, while the context lasts."""
    if as_json:
        yield _JsonProgress(unit)
        return
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)

        def show(done: int, total: int, part: str) -> None:
            bar.update(task, completed=done, total=total, description=f"{what} {part}".strip())

        yield show


class _JsonProgress:
    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._begun = time.monotonic()
        self._last = 0.0

    def __call__(self, done: int, total: int, part: str) -> None:
        now = time.monotonic()
        if now < self._last + SECONDS_BETWEEN_LINES and done < total:
            return
        self._last = now
        left = {"seconds_left": (now - self._begun) / done * (total - done)} if done else {}
        write_json(progress=done / total if total else 0.0, message=f"{self._unit} {done} of {total}", **left)
