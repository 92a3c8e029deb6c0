# SPDX-License-Identifier: GPL-3.0-or-later
"""All that panels show, as one frozen value, and what may happen to it. No bpy: see ``transition``."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ...bridge.messages import (
    Exported,
    Failure,
    History,
    JobStatus,
    PreviewRequest,
    Reply,
    Request,
    RunOpen,
    TrainResume,
    TrainStart,
    Welcome,
    WhenClosed,
)
from .task import TaskEnded, TaskProgress

INSTALL, CHECK, DATASET, LOOK, PHOTOS = "install", "check", "dataset", "look", "photos"
#: Seconds without progress after which it is said what is being done, and for how long.
QUIET_SECONDS = 20
#: Of the check's error where a package that training needs is not installed (backend/cli/check_report.py).
MISSING_MODULE = "missing_module"

#: Of the backend's error where what it prepared was stopped (backend/serve/engine.py).
CANCELLED = "cancelled"


@dataclass(frozen=True)
class Problem:
    """Something that went wrong, for people. ``log``: a file that tells more, or empty."""

    message: str
    hint: str = ""
    log: str = ""


@dataclass(frozen=True)
class Pace:
    """How long something at work has shown no progress: whole seconds, 0 below ``QUIET_SECONDS``.

    ``since``: the time at which it was first seen as it is now; negative: it has not been seen yet.
    """

    quiet: int = 0
    since: float = -1.0

    def at(self, now: float) -> "Pace":
        if self.since < 0.0:
            return Pace(since=now)
        seconds = int(now - self.since)
        quiet = seconds if seconds >= QUIET_SECONDS else 0
        return self if quiet == self.quiet else replace(self, quiet=quiet)


@dataclass(frozen=True)
class Running:
    """A child process at work: installing, checking, making a data set, looking at photos.

    ``python``: the one that is checked, where it is to take the place of the chosen one if it passes.
    ``makes``: the file or folder that will be there when it has ended, as far as that is known.
    """

    name: str
    log: str
    fraction: float = 0.0
    message: str = ""
    seconds_left: float = -1.0
    cancelling: bool = False
    python: str = ""
    makes: str = ""
    pace: Pace = Pace()


@dataclass(frozen=True)
class Made:
    """What the task of a name has made last: a file or a folder. Shown until it is dismissed."""

    task: str
    path: str


@dataclass(frozen=True)
class Backend:
    """The trainer's Python, and what the last check of it found. ``report``: {} until it passed one.

    ``incomplete``: it failed for a package that is not installed.
    """

    python: str = ""
    report: dict[str, Any] = field(default_factory=dict)
    problem: Problem | None = None
    incomplete: bool = False

    @property
    def ready(self) -> bool:
        return bool(self.python and self.report)

    @property
    def missing(self) -> tuple[str, ...]:
        """What photos need and the check did not find, as pip takes it."""
        missing = self.report.get("missing")
        return tuple(map(str, missing)) if isinstance(missing, list) else ()


LinkStatus = Literal["off", "starting", "connecting", "connected"]


@dataclass(frozen=True)
class Link:
    """The connection to the backend's process.

    ``starting``: the process was started and has not yet said where it listens. ``problem``: why the last
    connection ended, if nobody wanted that. ``pid``: of the backend's process, 0 where there is none; with
    the status ``off`` it lives and does not answer. ``barred``: why no connection to that process is tried
    again, though it lives: it takes none from this version, or it is ending.
    """

    status: LinkStatus = "off"
    welcome: Welcome | None = None
    log: str = ""
    pid: int = 0
    problem: Problem | None = None
    barred: Problem | None = None


#: Of a process that was asked to end without a connection, and may be saving.
ENDING = Problem("The backend is ending", "Wait until it has saved, or end it at once")


@dataclass(frozen=True)
class Dataset:
    """The chosen data set: ``folder``, what it holds in a few ``lines``, and what is wrong with that.

    Neither lines nor a problem: it is being looked at.
    """

    folder: str = ""
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    problem: Problem | None = None


@dataclass(frozen=True)
class Photos:
    """A folder of photos that was looked at, before the long work: what was understood of it.

    ``options``: what it was looked at with, as ``PhotoOptions`` has them. ``seconds``: how long preparing
    will take, negative where unknown. Empty and without a problem: it is being looked at.
    """

    folder: str = ""
    options: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    seconds: float = -1.0
    problem: Problem | None = None


@dataclass(frozen=True)
class Prepared:
    """What came of the photos that were prepared last: the data set's folder, how well the places were found,
    and what is worth a word."""

    folder: str = ""
    found: str = ""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class State:
    """The whole of it.

    Of the backend, whichever .blend is open: ``backend``, ``link``, ``job`` and its ``history``, ``waiting``,
    ``beginning``, ``stopping``, ``read``, ``pace`` (the training's), ``tasks``. They end with its process, or
    when it says so. Of the file: ``dataset``, ``photos``, ``prepared``, ``exported``, ``made``, ``problem``.
    They end when another is opened.
    What the panel says of a job it says to the file whose run it is (``advice.is_of_file``).

    ``waiting``: requests to be sent once there is a connection. ``beginning``: the request for a new job that
    is not answered yet; until then what the backend says of its job is of the former one. ``stopping``:
    whether the user has asked the training to stop, and may end the process now. ``read``: the job's
    failure that the user has dismissed; the backend keeps reporting it.
    """

    backend: Backend = Backend()
    tasks: tuple[Running, ...] = ()
    link: Link = Link()
    job: JobStatus = field(default_factory=JobStatus)
    history: History = field(default_factory=History)
    dataset: Dataset = Dataset()
    photos: Photos = Photos()
    prepared: Prepared = Prepared()
    waiting: tuple[Request, ...] = ()
    beginning: TrainStart | TrainResume | RunOpen | None = None
    stopping: bool = False
    pace: Pace = Pace()
    exported: Exported | None = None
    made: Made | None = None
    problem: Problem | None = None
    read: Failure | None = None

    def task(self, name: str) -> Running | None:
        return next((task for task in self.tasks if task.name == name), None)

    @property
    def active(self) -> bool:
        """Whether a training is under way, or halted with its process holding it."""
        # A backend that loads its libraries is "preparing" as well, for no run.
        return bool(self.job.run) and self.job.state in ("preparing", "training", "paused", "stopping")


# ---- what may happen ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PythonChosen:
    """Another Python for the trainer; ``report`` is that of an earlier check of the same one."""

    python: str
    report: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TaskStarted:
    """``python``: of a check, the one that is checked where it is not the chosen one. ``makes``: where what
    it makes will be, where that is there as soon as it has ended."""

    name: str
    log: str
    python: str = ""
    makes: str = ""


@dataclass(frozen=True)
class TaskCancelled:
    """Somebody asked it to end; its ``TaskEnded`` is still to come."""

    name: str


@dataclass(frozen=True)
class TaskMade:
    """What a task has computed was taken in, and is at ``path`` now."""

    task: str
    path: str


@dataclass(frozen=True)
class TimePassed:
    """It is ``now``, in seconds of any clock; comes again and again while something is at work."""

    now: float


@dataclass(frozen=True)
class Asked:
    """The user wants this of the backend; it is started first where it does not run."""

    request: Request


@dataclass(frozen=True)
class StopAsked:
    """The user wants the training to save and stop."""


@dataclass(frozen=True)
class EndAsked:
    """The user does not wait until it has saved: the backend's process is to end at once."""


@dataclass(frozen=True)
class Found:
    """A backend's connection file is there, and its process lives."""

    log: str
    pid: int


@dataclass(frozen=True)
class Started:
    """A backend's process was started."""

    log: str


@dataclass(frozen=True)
class Connected:
    welcome: Welcome


@dataclass(frozen=True)
class LinkLost:
    """The connection ended, or could not be made. ``clean``: the other side said good-bye.

    ``refusal``: what the backend answered to hello, where it takes none of this Blender.
    """

    reason: str
    clean: bool = False
    refusal: Failure | None = None


@dataclass(frozen=True)
class ProcessEnded:
    """The process that this Blender started has ended before or while it was connected."""

    status: int
    last_line: str = ""


@dataclass(frozen=True)
class Vanished:
    """The process that did not answer is no more."""


@dataclass(frozen=True)
class NotEnded:
    """The system does not let this Blender end the process ``pid``, for ``reason``."""

    pid: int
    reason: str


@dataclass(frozen=True)
class Received:
    """An event of the backend, or its reply to ``request``."""

    message: Reply
    request: Request | None = None


@dataclass(frozen=True)
class Refused:
    """The backend answered ``request`` with an error."""

    request: Request
    failure: Failure


@dataclass(frozen=True)
class DatasetChosen:
    dataset: Dataset


@dataclass(frozen=True)
class PhotosChosen:
    """Another folder of photos, or other options: it is looked at anew. No folder: none is wanted."""

    folder: str
    options: tuple[str, ...] = ()


@dataclass(frozen=True)
class NotTaken:
    """What a task has made could not be taken into the scene."""

    problem: Problem


@dataclass(frozen=True)
class FileOpened:
    """Another .blend is open now, or a new one: what was said of the former one is past."""


@dataclass(frozen=True)
class Dismissed:
    """The user has read the problem."""


@dataclass(frozen=True)
class MadeDismissed:
    """The user has read what was made."""


Event = (
    PythonChosen
    | TaskStarted
    | TaskProgress
    | TaskCancelled
    | TaskEnded
    | TaskMade
    | TimePassed
    | Asked
    | StopAsked
    | EndAsked
    | Found
    | Started
    | Connected
    | LinkLost
    | ProcessEnded
    | Vanished
    | NotEnded
    | Received
    | Refused
    | DatasetChosen
    | PhotosChosen
    | NotTaken
    | FileOpened
    | Dismissed
    | MadeDismissed
)


# ---- what is to be done about it ---------------------------------------------------------------------------


@dataclass(frozen=True)
class StartBackend:
    """Start the process, which will tell by its connection file where it listens."""


@dataclass(frozen=True)
class Connect:
    """Connect to the backend whose connection file is there."""


@dataclass(frozen=True)
class Send:
    request: Request


@dataclass(frozen=True)
class EndBackend:
    """Let the process save and end, whoever started it; where it does not, it is killed after a while."""

    pid: int


@dataclass(frozen=True)
class KillBackend:
    """End the process at once, whoever started it."""

    pid: int


@dataclass(frozen=True)
class KeepReport:
    """Remember across sessions that this Python passed its check."""

    python: str
    report: dict[str, Any]


@dataclass(frozen=True)
class SummariseDataset:
    """Look at a data set that has just been made."""

    folder: str


Effect = StartBackend | Connect | Send | EndBackend | KillBackend | KeepReport | SummariseDataset

#: Nobody pressed a button for them: their refusals are no news. Previews are asked for all the time, and what
#: is to become of a training is said whenever this Blender comes into control.
QUIET_REQUESTS = (PreviewRequest, WhenClosed)
