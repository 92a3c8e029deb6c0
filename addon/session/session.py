# SPDX-License-Identifier: GPL-3.0-or-later
"""The one impure runner: carries out what ``transition`` asks for, and takes in what happens. No bpy.

Everything is called from Blender's main thread; ``pump`` must be called now and then (a timer does it in a
window, operators that wait do it in scripts), and never waits itself.
"""

import json
import os
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ...bridge.atomic import atomic_path
from ...bridge.connection import is_of_another, live_connection, private_home
from ...bridge.errors import FileDamagedError, FileMissingError, OutputError, PhysHDRError
from ...bridge.messages import JobStatus, PreviewFrame, PreviewRequest, Request, WhenClosed
from .client import Client, PreviewRefused
from .dataset_look import DatasetLook
from .photos import look_command
from .process import ask_to_end, clean_environment, is_alive, kill, open_log, spawn
from .state import (
    LOOK,
    Asked,
    Connect,
    Dataset,
    DatasetChosen,
    Effect,
    EndBackend,
    Event,
    Found,
    KeepReport,
    KillBackend,
    LinkLost,
    NotEnded,
    PhotosChosen,
    ProcessEnded,
    PythonChosen,
    Received,
    Send,
    StartBackend,
    Started,
    State,
    SummariseDataset,
    TaskCancelled,
    TaskStarted,
    TimePassed,
    Vanished,
)
from .task import ChildTask, TaskEnded
from .transition import transition

LOG_FILE = "backend.log"
CHOICE_FILE = "backend.json"
#: A log that has grown larger is begun anew.
LOG_BYTES = 4 << 20
#: Seconds in which a backend that was started must have said where it listens.
START_SECONDS = 60.0
#: Seconds between looks for a backend that another Blender started.
LOOK_SECONDS = 2.0
#: How long Blender waits for a look at a data set: on a local disk it is done by then.
DATASET_SECONDS = 0.2
#: How long a backend of ours whose connection is gone has to end before another one is started.
ENDING_SECONDS = 0.5
#: How long one that was asked to end without a connection has to save; then it is killed.
SAVING_SECONDS = 60.0


class Session:
    """The state, and the processes and connection behind it.

    ``home``: the backend's folder, with the choice of its Python, its connection file, log and caches.
    ``launcher``: the script that starts it. ``name``, ``version``: of this Blender and extension.
    """

    def __init__(self, home: Path, launcher: Path, name: str = "Blender", version: str = "") -> None:
        self.home, self.launcher, self.name, self.version = home, launcher, name, version
        self.state = State()
        #: Counts the changes of the state: panels and pictures compare it.
        self.changes = 0
        self.when_closed: WhenClosed = WhenClosed(training="keep")
        self._tasks: dict[str, ChildTask] = {}
        self._ended: dict[str, TaskEnded] = {}
        self._look_at_dataset: DatasetLook | None = None
        self._client: Client | None = None
        self._process = None
        self._started = 0.0
        self._looked = 0.0
        self._in_control = False  # as the backend said last
        self._to_kill = (0, 0.0)  # the process that was asked to end, 0 for none, and when it is killed
        self.dispatch(read_choice(home / CHOICE_FILE))

    # -- what Blender asks ---------------------------------------------------------------------------------

    def dispatch(self, event: Event) -> None:
        """Let ``event`` happen: the state follows, and what it asks for is done."""
        before = self.state
        self.state, effects = transition(before, event)
        if self.state is not before:
            self.changes += 1
        for effect in effects:
            self._run(effect)

    def ask(self, request: Request) -> None:
        """Ask the backend, which is started first where it does not run."""
        self.dispatch(Asked(request))

    def start_task(
        self,
        name: str,
        command: list[str],
        log: Path,
        environment: dict[str, str] | None = None,
        python: str = "",
        makes: str = "",
    ) -> None:
        """Start a child process; one of a name at a time. Raises ``OutputError``.

        ``python``: of a check, the one that is checked where it is not the chosen one. ``makes``: the file or
        folder that is there once it has ended well; empty where that says its result, or whoever takes it.
        """
        if name in self._tasks:
            raise OutputError(f"{name} is under way already", "Wait for it to end, or cancel it.")
        self._tasks[name] = ChildTask(name, command, log, environment)
        self._ended.pop(name, None)
        self.dispatch(TaskStarted(name, str(log), python, makes))

    def ended(self, name: str) -> TaskEnded | None:
        """How the task of a name ended that was started last; None while it runs, or where none was."""
        return self._ended.get(name)

    def cancel_task(self, name: str) -> None:
        if name in self._tasks:
            self._tasks[name].cancel()
            self.dispatch(TaskCancelled(name))

    def set_when_closed(self, when_closed: WhenClosed) -> None:
        """What becomes of a training when this Blender closes."""
        self.when_closed = when_closed
        if self._in_control:
            self._send(when_closed)

    def choose_dataset(self, folder: str) -> None:
        """Look at a data set's folder, for the panel; what takes longer than a moment comes with ``pump``."""
        self._look_at_dataset = look = DatasetLook(folder)
        found = look.take(DATASET_SECONDS)
        if found is not None:
            self._look_at_dataset = None
        self.dispatch(DatasetChosen(found or Dataset(folder)))

    def look_at_photos(self, folder: str, options: tuple[str, ...]) -> None:
        """Let the backend look at a folder of photos; what it understands comes into the state."""
        command = self.backend_command(*look_command(folder, options))
        self.dispatch(PhotosChosen(folder, options))
        try:
            self.start_task(LOOK, command, self.home / "look.log", self.environment())
        except OutputError as error:
            self.dispatch(TaskEnded(LOOK, ok=False, message=error.message, hint=error.hint))

    def request_preview(self, request: PreviewRequest) -> bool:
        """Ask for a picture; False where there is nobody to ask."""
        if self._client is None or not self.state.job.has_model:
            return False
        self._client.send(request)
        return True

    def take_preview(self) -> PreviewFrame | PreviewRefused | None:
        """The newest picture since the last call, or why there will be none."""
        return self._client.take_preview() if self._client else None

    # -- the pump --------------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether there is something that ``pump`` should look after often."""
        waits = bool(self._tasks) or self._look_at_dataset is not None
        return waits or self.state.link.status != "off"

    def pump(self) -> bool:
        """Take in what has happened; returns whether the state has changed."""
        before = self.changes
        self._pump_tasks()
        self._pump_dataset()
        if self._client:
            for event in self._client.take():
                self.dispatch(event)
                if isinstance(event, Received) and isinstance(event.message, JobStatus):
                    self._follow_control(event.message.in_control)
                if isinstance(event, LinkLost):
                    self._forget_client()
        self._pump_process()
        if self.state.tasks or self.state.active:
            self.dispatch(TimePassed(time.monotonic()))
        return self.changes != before

    def wait(
        self, done: Callable[[State], bool], timeout: float, heed: Callable[[], None] = lambda: None
    ) -> bool:
        """Pump until ``done`` or ``timeout`` seconds, for scripts; returns whether it is done."""
        end = time.monotonic() + timeout
        while True:
            self.pump()
            heed()
            if done(self.state):
                return True
            if time.monotonic() > end:
                return False
            time.sleep(0.01)

    def close(self) -> None:
        """Leave: tasks are cancelled, the connection closed; a training goes by ``when_closed``."""
        for task in self._tasks.values():
            task.cancel()
        self._tasks.clear()
        if self._client:
            self._client.close()
            self._client = None

    # -- effects ---------------------------------------------------------------------------------------------

    def _run(self, effect: Effect) -> None:
        match effect:
            case StartBackend():
                self._start_backend()
            case Connect():
                self._connect()
            case Send(request):
                self._send(request)
            case EndBackend(pid):
                self._end(pid, ask_to_end)
                self._to_kill = pid, time.monotonic() + SAVING_SECONDS
            case KillBackend(pid):
                self._end(pid, kill)
            case KeepReport():
                write_choice(self.home / CHOICE_FILE, effect)
            case SummariseDataset(folder):
                self.choose_dataset(folder)

    def _follow_control(self, in_control: bool) -> None:
        """Who comes into control says what becomes of a training: the backend forgets the former's word."""
        if in_control and not self._in_control:
            self._send(self.when_closed)
        self._in_control = in_control

    def _send(self, request: Request) -> None:
        if self._client:
            self._client.send(request)

    def environment(self) -> dict[str, str]:
        """Of every backend process: clean, and with the kernels' cache where it may be written."""
        return clean_environment(NUMBA_CACHE_DIR=str(self.home / "cache"))

    def backend_command(self, *arguments: str, python: str = "") -> list[str]:
        """The command of a backend process: of the chosen Python, or another ``python``."""
        return [python or self.state.backend.python, str(self.launcher), *arguments]

    def _start_backend(self) -> None:
        if self._process is not None:
            # One that was killed is a process until somebody asks how it ended: it would be found alive.
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDING_SECONDS)
        self._look()  # another Blender may have started one
        if self.state.link.status != "off":
            return
        log = self.home / LOG_FILE
        command = self.backend_command("serve", "--home", str(self.home), "--log", str(log))
        self.dispatch(Started(str(log)))
        try:
            private_home(self.home)
            if log.exists() and log.stat().st_size > LOG_BYTES:
                with suppress(OSError):  # Windows removes none that another has open: it grows on
                    log.unlink()
            # Another Blender may be starting one just now: its log must not be cut off.
            with open_log(log, "a") as output:
                self._process = spawn(command, output, self.environment())
        except OutputError as error:
            self.dispatch(LinkLost(f"{error.message}. {error.hint}"))
        except OSError as error:
            self.dispatch(LinkLost(f"cannot start {command[0]}: {error.strerror or error}"))
        self._started = time.monotonic()

    def _connect(self) -> None:
        try:
            connection = live_connection(self.home)
        except PhysHDRError as error:
            self.dispatch(LinkLost(error.message))
            return
        if self._client:
            self._client.close()
        self._client = Client(connection, self.name, self.version)

    def _end(self, pid: int, how: Callable[[int], None]) -> None:
        """End the backend's process: only if it lives, and its connection file names it still."""
        with suppress(FileMissingError, FileDamagedError):
            if live_connection(self.home).pid == pid:
                try:
                    how(pid)
                except OSError as error:
                    self.dispatch(NotEnded(pid, error.strerror or str(error)))

    def _forget_client(self) -> None:
        if self._client:
            self._client.close()
            self._client = None
        self._in_control = False
        self._looked = time.monotonic()  # not again at once

    def _pump_tasks(self) -> None:
        for name, task in list(self._tasks.items()):
            for event in task.poll():
                if isinstance(event, TaskEnded):
                    del self._tasks[name]
                    self._ended[name] = event
                self.dispatch(event)

    def _pump_dataset(self) -> None:
        look = self._look_at_dataset
        if look is None or (found := look.take()) is None:
            return
        self._look_at_dataset = None
        if self.state.dataset.folder == look.folder:  # else another file was opened meanwhile
            self.dispatch(DatasetChosen(found))

    def _pump_process(self) -> None:
        """Follow a process that was started; look now and then for one that others started."""
        now = time.monotonic()
        if self._process is not None and (status := self._process.poll()) is not None:
            self._process = None
            if self.state.link.status == "starting":
                self.dispatch(ProcessEnded(status, _last_line(self.home / LOG_FILE)))
        match self.state.link.status:
            case "starting":
                self._look()
                if self.state.link.status == "starting" and now > self._started + START_SECONDS:
                    self.dispatch(LinkLost(f"it did not start within {START_SECONDS:.0f} s"))
            case "off" if now > self._looked + LOOK_SECONDS:
                self._looked = now
                if not self._look() and self.state.link.pid:
                    self.dispatch(Vanished())
        pid, at = self._to_kill
        if pid and now > at:
            self._to_kill = 0, 0.0
            self._end(pid, kill)

    def _look(self) -> bool:
        """Look for a backend; returns whether there is one that lives."""
        with suppress(FileMissingError, FileDamagedError):
            connection = live_connection(self.home)
            if is_alive(connection.pid):  # machines may share a home, and the backend be another one's
                self.dispatch(Found(connection.log, connection.pid))
                return True
        return False


def read_choice(path: Path) -> PythonChosen:
    """The Python that passed a check in an earlier session; an empty one where there is none.

    It will be run: one that another user wrote down is none.
    """
    try:
        with open(path, encoding="utf-8") as file:
            if is_of_another(os.fstat(file.fileno())):
                return PythonChosen("")
            content = json.loads(file.read())
        python, report = str(content["python"]), dict(content["report"])
    except (OSError, ValueError, KeyError, TypeError):
        return PythonChosen("")
    return PythonChosen(python, report) if Path(python).exists() else PythonChosen("")


def write_choice(path: Path, kept: KeepReport) -> None:
    """Remember a Python; where that is impossible it is asked for again next time, no more."""
    with suppress(OutputError), atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"python": kept.python, "report": kept.report}), encoding="utf-8")


def _last_line(log: Path) -> str:
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1][:200] if lines else ""
