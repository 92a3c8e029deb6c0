# SPDX-License-Identifier: GPL-3.0-or-later
"""Consumers of the training's events: the terminal, TensorBoard, and ``log.jsonl``."""

import dataclasses
import json
import shutil
import time
from pathlib import Path

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
        self._file = open(self.folder / LOG_FILE, "a", encoding="utf-8")
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

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
        if self._board:
            self._board.close()
        self._file.close()

    def show(self, event: events.Event) -> None:
        """Take one event; raises ``OutputError`` where it cannot be kept."""
        record = {"event": type(event).__name__.lower(), "time": time.time(), **dataclasses.asdict(event)}
        try:
            self._file.write(json.dumps(record) + "\n")
            self._file.flush()
        except OSError as error:
            raise OutputError(
                f"cannot write {self._file.name}: {error.strerror or error}", "Free some space, then resume."
            ) from error
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
        if self._board is None:
            # Only now: importing TensorBoard takes a second, in which the first iterations are already done.
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(self.folder / TENSORBOARD_FOLDER))
        for name, value in event.losses.items():
            self._board.add_scalar(f"loss/{name}", value, step)
        for name, value in event.monitor.items():
            self._board.add_scalar(f"test view/{name}", value, step)
        if event.gaussians:
            self._board.add_scalar("gaussians", event.gaussians, step)
        self._board.add_scalar("iterations per second", event.iterations_per_second, step)

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
