# SPDX-License-Identifier: GPL-3.0-or-later
"""Logs a training's events in its folder: ``log.jsonl`` and TensorBoard's files."""

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

from ...bridge.errors import OutputError
from ..train import events
from ..train.checkpoint import how_to_go_on
from .terminal import TrainingBar

LOG_FILE = "log.jsonl"
TENSORBOARD_FOLDER = "tensorboard"


class EventLog:
    """Logs events in the run's folder, and shows them (``terminal``). A context manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._bar = TrainingBar()

    @staticmethod
    def clear(folder: Path) -> None:
        """Remove the logs of a replaced run."""
        (folder / LOG_FILE).unlink(missing_ok=True)
        shutil.rmtree(folder / TENSORBOARD_FOLDER, ignore_errors=True)

    def __enter__(self) -> "EventLog":
        self._board = None
        with self._writing(self.folder / LOG_FILE):
            self._file = open(self.folder / LOG_FILE, "a", encoding="utf-8")
        self._hook, threading.excepthook = threading.excepthook, self._thread_failed
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Raises ``OutputError`` if the last events cannot be written, unless another error is raised."""
        self._bar.stop()
        failures: list[OutputError] = []
        # On a full disk, closing tries to flush; the other must still be closed.
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
        """Turn errors into ``OutputError`` naming ``path``, because not all libraries name it."""
        try:
            yield
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            remedy = "Free some space on its disk" if full else "Make it writable"
            raise OutputError(
                f"cannot write {path}: {error.strerror or error}",
                f"{remedy}, then {how_to_go_on(self.folder)}.",
            ) from error

    def _thread_failed(self, failed: threading.ExceptHookArgs) -> None:
        """Ignore errors of TensorBoard's thread, which its next call raises again."""
        if issubclass(failed.exc_type, OSError) and type(failed.thread).__module__.startswith("tensorboard."):
            return
        self._hook(failed)

    def show(self, event: events.Event) -> None:
        """Log and show one event; raises ``OutputError`` if it cannot be written."""
        record = {"event": type(event).__name__.lower(), "time": time.time(), **dataclasses.asdict(event)}
        with self._writing(self.folder / LOG_FILE):
            self._file.write(json.dumps(record) + "\n")
            self._file.flush()
        if isinstance(event, events.Progress):
            with self._writing(self.folder / TENSORBOARD_FOLDER):
                self._write_to_board(event)
        self._bar.show(event)

    def _write_to_board(self, event: events.Progress) -> None:
        if self._board is None:
            # Imported late, because it takes a second, in which the first iterations are done.
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(self.folder / TENSORBOARD_FOLDER))
        step = event.iteration
        for name, value in event.losses.items():
            self._board.add_scalar(f"loss/{name}", value, step)
        for name, value in event.monitor.items():
            self._board.add_scalar(f"held-out view/{name}", value, step)
        if event.gaussians:
            self._board.add_scalar("gaussians", event.gaussians, step)
        self._board.add_scalar("iterations per second", event.iterations_per_second, step)
