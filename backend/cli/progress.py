# SPDX-License-Identifier: GPL-3.0-or-later
"""Consumers of the training's events: the terminal, TensorBoard, and ``log.jsonl``."""

import dataclasses
import errno
import json
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from ...bridge.errors import OutputError
from ..train import events

console = Console(highlight=False)

#: Without a terminal a line is printed this often (seconds), so that logs stay short.
SECONDS_BETWEEN_LINES = 10.0

LOG_FILE = "log.jsonl"
TENSORBOARD_FOLDER = "tensorboard"


class EventLog:
    """Shows events as they come and keeps them in the run's folder. A context manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._monitor: dict[str, float] = {}
        self._last_line = 0.0

    @staticmethod
    def clear(folder: Path) -> None:
        """Forget the logs of a run that is replaced."""
        (folder / LOG_FILE).unlink(missing_ok=True)
        shutil.rmtree(folder / TENSORBOARD_FOLDER, ignore_errors=True)

    def __enter__(self) -> "EventLog":
        self._board = None
        with self._writing(self.folder / LOG_FILE):
            self._file = open(self.folder / LOG_FILE, "a", encoding="utf-8")
        self._hook, threading.excepthook = threading.excepthook, self._thread_failed
        self._bar = Progress(
            TextColumn("train"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[status]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._bar.start()
        self._task = self._bar.add_task("train", total=None, status="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Raises ``OutputError`` where the last events cannot be kept, unless an error is on its way."""
        self._bar.stop()
        failures: list[OutputError] = []
        # On a full disk both try again to write what they hold; either must be closed all the same.
        for path, log in (
            (self.folder / TENSORBOARD_FOLDER, self._board),
            (self.folder / LOG_FILE, self._file),
        ):
            try:
                with self._writing(path):
                    if log:
                        log.close()
            except OutputError as failure:
                failures.append(failure)
        threading.excepthook = self._hook
        if failures and error is None:
            raise failures[0]

    @contextmanager
    def _writing(self, path: Path) -> Iterator[None]:
        """What fails in here is told as an ``OutputError`` that names ``path``: not all libraries do."""
        try:
            yield
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            remedy = "Free some space on its disk" if full else "Make it writable"
            raise OutputError(
                f"cannot write {path}: {error.strerror or error}",
                f"{remedy}, then go on: physhdr train --resume {self.folder}",
            ) from error

    def _thread_failed(self, failed: threading.ExceptHookArgs) -> None:
        """What TensorBoard's thread could not write, its next call raises: it is not shown twice."""
        if issubclass(failed.exc_type, OSError) and type(failed.thread).__module__.startswith("tensorboard."):
            return
        self._hook(failed)

    def show(self, event: events.Event) -> None:
        """Take one event; raises ``OutputError`` where it cannot be kept."""
        record = {"event": type(event).__name__.lower(), "time": time.time(), **dataclasses.asdict(event)}
        with self._writing(self.folder / LOG_FILE):
            self._file.write(json.dumps(record) + "\n")
            self._file.flush()
        if isinstance(event, events.Started):
            self._bar.update(self._task, total=event.iterations, completed=event.iteration)
            gaussians = f"{event.gaussians} Gaussians; " if event.gaussians else ""
            console.print(
                f"training from iteration {event.iteration}: {gaussians}{event.message}", soft_wrap=True
            )
        elif isinstance(event, events.Progress):
            self._show_progress(event)
        elif isinstance(event, events.Finished):
            state = "stopped" if event.stopped else "finished"
            used = f"{event.seconds:.0f} s ({event.cpu_seconds:.0f} CPU seconds)"
            console.print(f"{state} at iteration {event.iteration} after {used}")

    def _show_progress(self, event: events.Progress) -> None:
        self._monitor |= event.monitor
        step = event.iteration
        with self._writing(self.folder / TENSORBOARD_FOLDER):
            self._keep_on_board(event)

        losses = "  ".join(f"{name} {value:.4f}" for name, value in event.losses.items())
        measured = "  ".join(f"{name} {value:.2f}" for name, value in self._monitor.items())
        gaussians = f"  {event.gaussians} G" if event.gaussians else ""
        status = f"{losses}  {measured}{gaussians}  {event.iterations_per_second:.0f} it/s"
        self._bar.update(self._task, completed=step, status=status)
        now = time.monotonic()
        last = event.iteration == event.iterations
        if not console.is_terminal and (last or now - self._last_line > SECONDS_BETWEEN_LINES):
            self._last_line = now
            console.print(
                f"{step:6d}/{event.iterations}  {status}  {event.seconds_left:.0f} s left", soft_wrap=True
            )

    def _keep_on_board(self, event: events.Progress) -> None:
        if self._board is None:
            # Only now: importing TensorBoard takes a second, in which the first iterations are already done.
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(self.folder / TENSORBOARD_FOLDER))
        step = event.iteration
        for name, value in event.losses.items():
            self._board.add_scalar(f"loss/{name}", value, step)
        for name, value in event.monitor.items():
            self._board.add_scalar(f"test view/{name}", value, step)
        if event.gaussians:
            self._board.add_scalar("gaussians", event.gaussians, step)
        self._board.add_scalar("iterations per second", event.iterations_per_second, step)
