# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows a running training: a bar on a terminal, occasional lines in a file."""

import io
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any, cast

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from ..train import events

#: The attribute in which rich stores stdout while a bar replaces it.
PROXIED = "rich_proxied_file"


class Terminal(Console):
    """Shows text unchanged: brackets in paths are not markup, and colons not emoji.

    A sentence is one line, however long, so that names in it can be found and copied. Tables fit the
    terminal's width.
    """

    def __init__(self, file: IO[str] | None = None) -> None:
        super().__init__(file=file, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, soft_wrap: bool | None = None, **options: Any) -> None:
        if soft_wrap is None:
            soft_wrap = all(isinstance(each, str) for each in objects)
        super().print(*objects, soft_wrap=soft_wrap, **options)

    def on_broken_pipe(self) -> None:
        raise  # handled in ``main``; rich would exit with 1


class _OptionalStdout:
    """stdout while it can be written to; after that output is discarded without errors."""

    def __getattr__(self, name: str) -> Any:
        if name == PROXIED:  # a console must write to this file itself
            raise AttributeError(name)
        return getattr(_stdout(), name)

    def write(self, text: str) -> int:
        with _discarding():
            _stdout().write(text)
        return len(text)

    def flush(self) -> None:
        with _discarding():
            _stdout().flush()


def _stdout() -> IO[str]:
    """stdout itself, also while a bar of rich replaces it."""
    return getattr(sys.stdout, PROXIED, sys.stdout)


@contextmanager
def _discarding() -> Iterator[None]:
    """If stdout's reader is gone or its disk is full, discard pending and further output."""
    try:
        yield
    except OSError:
        with suppress(io.UnsupportedOperation), open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), _stdout().fileno())


#: Output of all commands; a command whose output cannot be written fails.
console = Terminal()
#: A training's progress, which may be lost without failing the training: the run's log has all of it.
aside = Terminal(cast(IO[str], _OptionalStdout()))

#: Without a terminal a line is printed this often (seconds), so that logs stay short.
SECONDS_BETWEEN_LINES = 10.0


class TrainingBar:
    """Shows a training's events on the console, from ``start`` to ``stop``."""

    def __init__(self) -> None:
        self._monitor: dict[str, float] = {}
        self._last_line = 0.0
        self._bar = Progress(
            TextColumn("train"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[status]}"),
            TextColumn("{task.fields[left]}"),
            console=aside,
            disable=not aside.is_terminal,
        )

    def start(self) -> None:
        self._bar.start()
        self._task = self._bar.add_task("train", total=None, status="", left="")

    def stop(self) -> None:
        self._bar.stop()

    def show(self, event: events.Event) -> None:
        """Show one event; those without interest to people are ignored."""
        if isinstance(event, events.Started):
            self._bar.update(self._task, total=event.iterations, completed=event.iteration)
            gaussians = f"{event.gaussians} Gaussians; " if event.gaussians else ""
            aside.print(f"training from iteration {event.iteration}: {gaussians}{event.message}")
        elif isinstance(event, events.Progress):
            self._show_progress(event)
        elif isinstance(event, events.Finished):
            state = "stopped" if event.stopped else "finished"
            used = f"{event.seconds:.0f} s ({event.cpu_seconds:.0f} CPU seconds)"
            message = f"; {event.message}" if event.message else ""
            aside.print(f"{state} at iteration {event.iteration} after {used}{message}")

    def _show_progress(self, event: events.Progress) -> None:
        self._monitor |= event.monitor
        step = event.iteration
        losses = "  ".join(f"{name} {value:.4f}" for name, value in event.losses.items())
        measured = "  ".join(f"{name} {value:.2f}" for name, value in self._monitor.items())
        gaussians = f"  {event.gaussians} G" if event.gaussians else ""
        status = f"{losses}  {measured}{gaussians}  {event.iterations_per_second:.0f} it/s"
        left = f"{event.seconds_left:.0f} s left"
        self._bar.update(self._task, completed=step, status=status, left=left)
        now = time.monotonic()
        last = event.iteration == event.iterations
        if not aside.is_terminal and (last or now - self._last_line > SECONDS_BETWEEN_LINES):
            self._last_line = now
            aside.print(f"{step:6d}/{event.iterations}  {status}  {left}")
