# SPDX-License-Identifier: GPL-3.0-or-later
"""What people see of a training while it runs: a bar on a terminal, a line now and then in a file."""

import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from ..train import events

#: Where every command says what it does.
console = Console(highlight=False)

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
            console=console,
            disable=not console.is_terminal,
        )

    def start(self) -> None:
        self._bar.start()
        self._task = self._bar.add_task("train", total=None, status="", left="")

    def stop(self) -> None:
        self._bar.stop()

    def show(self, event: events.Event) -> None:
        """One event, in words; those that say nothing to people are passed over."""
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
            message = f"; {event.message}" if event.message else ""
            console.print(f"{state} at iteration {event.iteration} after {used}{message}", soft_wrap=True)

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
        if not console.is_terminal and (last or now - self._last_line > SECONDS_BETWEEN_LINES):
            self._last_line = now
            console.print(f"{step:6d}/{event.iterations}  {status}  {left}", soft_wrap=True)
