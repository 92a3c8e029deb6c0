# SPDX-License-Identifier: GPL-3.0-or-later
"""How a run reports its progress: text for people, or JSON lines for programs (``--progress-json``)."""

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

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
        self.done = min(self.done + 1, self.total)
        if self.done % self.every and self.done != self.total:
            return
        spent = time.monotonic() - self.began
        left = self.seconds_left()
        filled = BAR * self.done // self.total
        bar = "#" * filled + "-" * (BAR - filled)
        line = f"{self.what} [{bar}] {self.done}/{self.total}  {spent:.0f} s, {left:.0f} s left  {note}"
        if self.stream.isatty():
            self.stream.write(f"\r\x1b[K{line}" + ("\n" if self.done == self.total else ""))
        else:
            self.stream.write(line.rstrip() + "\n")
        self.stream.flush()

    def seconds_left(self) -> float:
        """As the items so far went; 0 before the first."""
        return (time.monotonic() - self.began) / max(1, self.done) * (self.total - self.done)


class Report:
    """For people: lines on stdout, warnings and errors on stderr."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self._progress: Progress | None = None
        self._whole = False
        self._where = ""

    @property
    def _text(self) -> TextIO:
        return sys.stdout  # looked up each time: tests and Blender replace it

    def say(self, line: str) -> None:
        """One line of report."""
        self._text.write(line + "\n")
        self._text.flush()

    def warn(self, line: str) -> None:
        """Something that the user should know; the run continues."""
        self.warnings.append(line)
        sys.stderr.write(f"warning: {line}\n")
        sys.stderr.flush()

    def begin_all(self, total: int) -> None:
        """``total`` poses of several data sets are about to be rendered: one progress for all."""
        self._whole = total > 0
        self._progress = Progress("render", total, self._text)

    def enter(self, where: str) -> None:
        """The data set ``where``, one of several, is begun; its warnings are its own."""
        self._where = f"{where} "
        self.warnings = []

    def begin(self, total: int) -> None:
        """``total`` poses are about to be rendered."""
        if not self._whole:
            self._progress = Progress("render", total, self._text)

    def start(self, name: str) -> None:
        """The pose ``name`` is being rendered now."""

    def advance(self, name: str) -> None:
        """The pose ``name`` is done."""
        assert self._progress, "begin comes first"
        self._progress.advance(self._where + name)

    def finishing(self, what: str) -> None:
        """The poses are rendered; ``what`` of the rest is being done now."""

    def end(self, result: dict[str, Any]) -> None:
        """All is done; ``result`` sums up the data set."""

    def fail(self, code: str, message: str, hint: str = "") -> None:
        """The run ends here."""
        sys.stderr.write(f"error: {message}{': ' + hint if hint else ''}\n")


class JsonReport(Report):
    """For programs: one JSON object a line on stdout; what people read goes to stderr.

    ``{"progress": 0…1, "message": …, "seconds_left": …}`` before each pose and step, and
    last ``{"result": {…}}`` or ``{"error": {"code": …, "message": …, "hint": …}}``.
    """

    #: The share of rendering in the whole; brackets, points and the noise floor are the rest.
    RENDERING = 0.97

    @property
    def _text(self) -> TextIO:
        return sys.stderr

    def _emit(self, content: dict[str, Any]) -> None:
        sys.stdout.write(json.dumps(content, ensure_ascii=True) + "\n")
        sys.stdout.flush()

    def start(self, name: str) -> None:
        step = self._progress
        assert step, "begin comes first"
        line: dict[str, Any] = {"progress": self._share(), "message": f"rendering {self._where}{name}"}
        if step.done:
            line["seconds_left"] = round(step.seconds_left(), 1)
        self._emit(line)

    def finishing(self, what: str) -> None:
        self._emit({"progress": self._share(), "message": f"{self._where}{what}"})

    def _share(self) -> float:
        step = self._progress
        return round(self.RENDERING * (step.done / max(1, step.total) if step else 1.0), 4)

    def warn(self, line: str) -> None:
        super().warn(line)
        self._emit({"warning": line})

    def end(self, result: dict[str, Any]) -> None:
        self._emit({"progress": 1.0, "message": "complete", "seconds_left": 0.0})
        self._emit({"result": result})

    def fail(self, code: str, message: str, hint: str = "") -> None:
        super().fail(code, message, hint)
        self._emit({"error": {"code": code, "message": message, "hint": hint}})


@contextmanager
def quiet() -> Iterator[None]:
    """Keep what Blender itself writes (saved files, devices) off the process's stdout; errors still raise."""
    sys.stdout.flush()
    saved_stdout = os.dup(1)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        yield
    finally:
        os.dup2(saved_stdout, 1)
        os.close(saved_stdout)
        os.close(sink)
