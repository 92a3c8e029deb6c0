# SPDX-License-Identifier: GPL-3.0-or-later
"""A child process that works on something and says how far it is, one JSON object a line on its stdout.

* ``{"progress": 0.25, "message": "…", "seconds_left": 12.0}`` (the latter two may be missing),
* at the end ``{"result": {…}}``, or ``{"error": {"code": "…", "message": "…", "hint": "…"}}``.

Every other line, and all of stderr, goes to the log alone. No bpy here: a thread reads, ``poll`` tells.

Between it and Blender is ``addon/scripts/run_task.py``, which ends it when its stdin ends: because it was
cancelled, or because Blender is gone.
"""

import json
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...bridge.connection import private_home
from ...bridge.errors import OutputError
from .process import clean_environment, open_log, spawn

RUNNER = Path(__file__).resolve().parent.parent / "scripts" / "run_task.py"
#: Seconds that a cancelled child has to end by itself.
PATIENCE = 10.0
LAST_LINES = 12


@dataclass(frozen=True)
class TaskProgress:
    """How far it is: ``fraction`` 0…1, ``seconds_left`` negative where unknown."""

    task: str
    fraction: float
    message: str = ""
    seconds_left: float = -1.0


@dataclass(frozen=True)
class TaskEnded:
    """It ended. ``ok``: with status 0. ``cancelled``: because somebody asked. ``code``: the error's."""

    task: str
    ok: bool
    cancelled: bool = False
    message: str = ""
    hint: str = ""
    result: dict[str, Any] = field(default_factory=dict)
    code: str = ""


TaskEvent = TaskProgress | TaskEnded


class ChildTask:
    """Runs ``command``; its output is kept in ``log``, which lies in the home folder.

    Raises ``OutputError`` where that folder is not its owner's alone, or cannot be written.
    """

    def __init__(
        self, name: str, command: list[str], log: Path, environment: dict[str, str] | None = None
    ) -> None:
        self.name, self.log = name, log
        self._cancelled = False
        self._events: queue.SimpleQueue[TaskEvent] = queue.SimpleQueue()
        private_home(log.parent)
        runner = [sys.executable, "-I", "-S", str(RUNNER), str(PATIENCE)]
        try:
            self._log = open_log(log, "w")
        except OSError as error:
            what = f"cannot write {log}: {error.strerror or error}"
            raise OutputError(what, "Check that path, and that the disk has space.") from error
        try:
            self._log.write("$ " + " ".join(command) + "\n")
            self._process = spawn(
                [*runner, *command], subprocess.PIPE, environment or clean_environment(), subprocess.PIPE
            )
        except OSError as error:
            with suppress(OSError):
                self._log.close()
            what = f"cannot start {sys.executable}: {error.strerror or error}"
            raise OutputError(what, "It is Blender's own Python: reinstall Blender.") from error
        self._thread = threading.Thread(target=self._follow, name=f"physhdr {name}", daemon=True)
        self._thread.start()

    def poll(self) -> list[TaskEvent]:
        """What happened since the last call; the last event of all is a ``TaskEnded``."""
        events = []
        with suppress(queue.Empty):
            while True:
                events.append(self._events.get_nowait())
        return events

    def wait(self, timeout: float | None = None) -> None:
        """Until the process has ended (not on Blender's main thread, but in scripts and tests)."""
        self._thread.join(timeout)

    def cancel(self) -> None:
        """Ask it to end as CTRL-C does, so that it may clean up; after a while it is killed."""
        self._cancelled = True
        self._let_go()

    def _let_go(self) -> None:
        """End stdin, and with it whatever runs still."""
        assert self._process.stdin is not None
        self._process.stdin.close()

    def _follow(self) -> None:
        """The thread: whatever becomes of it, there is an end of the task."""
        ended = TaskEnded(self.name, False, message=f"{self.name}: its output cannot be read")
        try:
            ended = self._read()
        finally:
            self._let_go()
            with suppress(OSError):
                self._log.close()
            self._events.put(replace(ended, cancelled=self._cancelled))

    def _read(self) -> TaskEnded:
        """Take in what it says, to the end: a pipe that nobody empties would hold it up."""
        error: dict[str, Any] = {}
        result: dict[str, Any] = {}
        last: list[str] = []
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self._keep(line)
                match _json_line(line):
                    case {"progress": int(done) | float(done), **rest}:
                        left = rest.get("seconds_left", -1.0)
                        left = float(left) if isinstance(left, int | float) else -1.0
                        self._events.put(
                            TaskProgress(self.name, float(done), str(rest.get("message", "")), left)
                        )
                    case {"error": dict(found)}:
                        error = found
                    case {"result": dict(found)}:
                        result = found
                    case _:
                        last = [*last[1 - LAST_LINES :], line.strip()] if line.strip() else last
        status = self._process.wait()
        message = str(error.get("message", ""))
        if status and not message:
            ended = f"ended by signal {-status}" if status < 0 else f"ended with status {status}"
            message = f"{self.name} {ended}" + (f": {last[-1]}" if last else "")
        hint = str(error.get("hint", "")) or (f"The log is {self.log}" if status else "")
        code = str(error.get("code", ""))
        return TaskEnded(self.name, status == 0, False, message, hint, result, code)

    def _keep(self, line: str) -> None:
        """A line of the log; there are no more of them once the disk has refused one."""
        if not self._log.closed:
            try:
                self._log.write(line)
                self._log.flush()
            except OSError:
                with suppress(OSError):  # what waits to be written is refused again
                    self._log.close()


def _json_line(line: str) -> Any:
    if not line.startswith("{"):
        return None
    with suppress(ValueError, RecursionError):  # braces within braces, of no JSON of ours
        return json.loads(line)
    return None
