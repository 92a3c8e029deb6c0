# SPDX-License-Identifier: GPL-3.0-or-later
"""A child process that works on something and says how far it is, one JSON object a line on its stdout.

* ``{"progress": 0.25, "message": "…", "seconds_left": 12.0}`` (the latter two may be missing),
* at the end ``{"result": {…}}``, or ``{"error": {"code": "…", "message": "…", "hint": "…"}}``.

Every other line, and all of stderr, goes to the log alone. No bpy here: a thread reads, ``poll`` tells.
"""

import json
import queue
import subprocess
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...bridge.errors import OutputError
from .process import clean_environment, interrupt, kill, open_log, spawn

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
    """Runs ``command``; its output is kept in ``log``. Raises ``OutputError`` where it cannot start."""

    def __init__(
        self, name: str, command: list[str], log: Path, environment: dict[str, str] | None = None
    ) -> None:
        self.name, self.log = name, log
        self._cancelled = False
        self._events: queue.SimpleQueue[TaskEvent] = queue.SimpleQueue()
        try:
            log.parent.mkdir(parents=True, exist_ok=True)
            self._log = open_log(log, "w")
            self._log.write("$ " + " ".join(command) + "\n")
            self._process = spawn(command, subprocess.PIPE, environment or clean_environment())
        except OSError as error:
            raise OutputError(
                f"cannot start {command[0]}: {error.strerror or error}", f"See {log}, and check the path."
            ) from error
        self._thread = threading.Thread(target=self._read, name=f"physhdr {name}", daemon=True)
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
        """Ask it to end as CTRL-C does, so that it may clean up; kill it where it has not after a while."""
        self._cancelled = True
        if self._process.poll() is None:
            interrupt(self._process.pid)
            timer = threading.Timer(PATIENCE, self._kill)
            timer.daemon = True
            timer.start()

    def _kill(self) -> None:
        if self._process.poll() is None:
            kill(self._process.pid)

    def _read(self) -> None:
        error: dict[str, Any] = {}
        result: dict[str, Any] = {}
        last: list[str] = []
        assert self._process.stdout is not None
        with self._log as log:
            for line in self._process.stdout:
                log.write(line)
                log.flush()
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
        self._events.put(TaskEnded(self.name, status == 0, self._cancelled, message, hint, result, code))


def _json_line(line: str) -> Any:
    if not line.startswith("{"):
        return None
    with suppress(ValueError):
        return json.loads(line)
    return None
