# SPDX-License-Identifier: GPL-3.0-or-later
"""What becomes of the state when something happens: a pure function, tested without Blender."""

from dataclasses import replace
from typing import Any

from ...bridge.messages import (
    Done,
    Exported,
    Failure,
    History,
    HistoryGet,
    JobStatus,
    Reply,
    Request,
    RunOpen,
    Shutdown,
    StatusGet,
    TrainResume,
    TrainStart,
    TrainStop,
    Welcome,
)
from ...bridge.run_folder import same_folder
from . import job_words
from .dataset_words import in_the_dialogs_words
from .photos import in_panel_words, prepared, understood
from .state import (
    CANCELLED,
    CHECK,
    DATASET,
    ENDING,
    INSTALL,
    LOOK,
    MISSING_MODULE,
    PHOTOS,
    QUIET_REQUESTS,
    Asked,
    Backend,
    Connect,
    Connected,
    Dataset,
    DatasetChosen,
    Dismissed,
    Effect,
    EndAsked,
    EndBackend,
    Event,
    FileOpened,
    Found,
    KeepReport,
    KillBackend,
    Link,
    LinkLost,
    Made,
    MadeDismissed,
    NotEnded,
    NotTaken,
    Pace,
    Photos,
    PhotosChosen,
    Prepared,
    Problem,
    ProcessEnded,
    PythonChosen,
    Received,
    Refused,
    Running,
    Send,
    StartBackend,
    Started,
    State,
    StopAsked,
    SummariseDataset,
    TaskCancelled,
    TaskMade,
    TaskStarted,
    TimePassed,
    Vanished,
)
from .task import TaskEnded, TaskProgress

Result = tuple[State, tuple[Effect, ...]]
#: Of photos at which the look was broken off.
LOOK_CANCELLED = "The look at the photos was cancelled: what they are is not known"


def transition(state: State, event: Event) -> Result:
    """The state after ``event``, and what is to be done; nothing is done here."""
    match event:
        case PythonChosen(python, report):
            return replace(state, backend=Backend(python, report)), ()
        case TaskStarted(name, log, python, makes):
            tasks = (*_others(state, name), Running(name, log, python=python, makes=makes))
            made = Prepared() if name == PHOTOS else state.prepared
            # One that works stays the chosen one until the other has passed.
            backend = Backend(python) if python and not state.backend.ready else state.backend
            # An idle backend goes: the environment that it runs by is replaced.
            must_end = name == INSTALL and state.link.status == "connected"
            effects = (Send(Shutdown()),) if must_end else ()
            state = replace(state, backend=backend, tasks=tasks, prepared=made, made=None, problem=None)
            return state, effects
        case TaskProgress(name, fraction, message, left):
            task = state.task(name)
            has_moved = task is not None and (fraction, message) != (task.fraction, task.message)
            pace = {"pace": Pace()} if has_moved else {}
            return _with_task(state, name, fraction=fraction, message=message, seconds_left=left, **pace), ()
        case TaskCancelled(name):
            return _with_task(state, name, cancelling=True), ()
        case TaskEnded(name, ok, cancelled):
            task = state.task(name)
            path = (task.makes if task else "") or str(event.result.get("folder", ""))
            state, effects = _task_ended(state, event)
            return replace(state, made=Made(name, path)) if ok and not cancelled and path else state, effects
        case TaskMade(name, path):
            return replace(state, made=Made(name, path)), ()
        case TimePassed(now):
            return _aged(state, now), ()
        case Asked(request):
            return _asked(state, request)
        case StopAsked():
            if state.link.status != "connected":
                return state, ()
            return replace(state, stopping=True), (Send(TrainStop()),)
        case EndAsked():
            return state, (KillBackend(state.link.pid),) if state.stopping and state.link.pid else ()
        case Found(log, pid):
            former = state.link
            if former.status in ("connecting", "connected") or (former.barred and former.pid == pid):
                return state, ()
            link = Link("connecting", log=log, pid=pid, problem=None if former.barred else former.problem)
            return replace(state, link=link), (Connect(),)
        case Started(log):
            return replace(state, link=Link("starting", log=log), problem=None), ()
        case Connected(welcome):
            return _connected(state, welcome)
        case LinkLost(_, _, Failure() as refusal):
            return _not_taken(state, refusal), ()
        case LinkLost(reason, clean):
            return _link_lost(state, reason, clean), ()
        case ProcessEnded(status, last_line):
            if state.link.status != "starting":
                return state, ()  # then the connection tells
            what = f"the backend ended with status {status} before it could be reached"
            said = job_words.in_panel_words(last_line)
            return _link_lost(state, what + (f": {said}" if said else ""), clean=False), ()
        case Vanished():
            link = state.link
            problem = None if link.barred else link.problem
            return replace(state, link=replace(link, pid=0, problem=problem, barred=None)), ()
        case NotEnded(pid, reason):
            remedy = "End it in the system's list of processes."
            return replace(state, problem=Problem(f"Process {pid} cannot be ended: {reason}", remedy)), ()
        case Received(message, request):
            return _received(state, message, request)
        case Refused(request, failure):
            if isinstance(request, QUIET_REQUESTS):
                return state, ()
            failure = job_words.for_panel(failure)
            problem = Problem(failure.message, failure.hint)
            if isinstance(request, TrainStop):  # it continues, and can be asked again
                state = replace(state, stopping=False)
            if request == state.beginning:
                wanted = state.stopping and failure.code == CANCELLED
                refused = replace(state, problem=None if wanted else problem, beginning=None)
                return refused, (Send(StatusGet()),)
            return replace(state, problem=problem), ()
        case DatasetChosen(dataset):
            return replace(state, dataset=dataset), ()
        case NotTaken(problem):
            return replace(state, problem=problem), ()
        case PhotosChosen(folder, options):
            return replace(state, photos=Photos(folder, options)), ()
        case FileOpened():
            if state.link.status == "off":  # of a job that is past, and was the former file's
                state = _without_job(state)
            return replace(
                state,
                dataset=Dataset(),
                photos=Photos(),
                prepared=Prepared(),
                exported=None,
                made=None,
                problem=None,
                read=state.job.failure,
            ), ()
        case Dismissed():
            job = state.job
            state = replace(state, problem=None, read=job.failure)
            if state.link.status == "off" and job.state == "failed":
                state = _without_job(state)  # no backend is there that would tell it again
            link, backend = replace(state.link, problem=None), replace(state.backend, problem=None)
            return replace(state, link=link, backend=backend), ()
        case MadeDismissed():
            return replace(state, made=None), ()


# ---- tasks -------------------------------------------------------------------------------------------------


def _others(state: State, name: str) -> tuple[Running, ...]:
    return tuple(task for task in state.tasks if task.name != name)


def _with_task(state: State, name: str, **changes: Any) -> State:
    tasks = tuple(replace(task, **changes) if task.name == name else task for task in state.tasks)
    return replace(state, tasks=tasks)


def _aged(state: State, now: float) -> State:
    """How long all that is at work has shown no progress; the same ``state`` where that is nothing new."""
    tasks = tuple(_at(task, now) for task in state.tasks)
    is_at_work = state.active and state.job.state != "paused"
    pace = state.pace.at(now) if is_at_work else Pace()
    if pace == state.pace and all(new is old for new, old in zip(tasks, state.tasks, strict=True)):
        return state
    return replace(state, tasks=tasks, pace=pace)


def _at(task: Running, now: float) -> Running:
    pace = task.pace.at(now)
    return task if pace is task.pace else replace(task, pace=pace)


def _task_ended(state: State, event: TaskEnded) -> Result:
    task = state.task(event.task)
    log = task.log if task else ""
    state = replace(state, tasks=_others(state, event.task))
    if event.cancelled:
        if event.task == LOOK and state.photos.folder:
            # The folder stays, or the timer would look at it again at once.
            state = replace(state, photos=replace(state.photos, warnings=(LOOK_CANCELLED,)))
        return state, ()
    message, hint = event.message, event.hint
    if event.task in (LOOK, PHOTOS):
        message, hint = in_panel_words(message), in_panel_words(hint)
    elif event.task == DATASET:
        message, hint = in_the_dialogs_words(message), in_the_dialogs_words(hint)
    elif event.task in job_words.TARGETS:
        message, hint = job_words.of_result(message, hint, event.task)
    problem = None if event.ok else Problem(message, hint, log)
    match event.task:
        case name if name in (INSTALL, CHECK):
            checked = (task.python if task else "") or state.backend.python
            if problem and state.backend.ready and (name == INSTALL or checked != state.backend.python):
                return replace(state, problem=problem), ()  # what failed is not what works
            python = str(event.result.get("environment") or checked)
            if problem:
                incomplete = event.task == CHECK and event.code == MISSING_MODULE
                backend = replace(state.backend, report={}, problem=problem, incomplete=incomplete)
                return replace(state, backend=backend), ()
            state = replace(state, backend=Backend(python, event.result))
            return state, (KeepReport(python, event.result),)
        case name if name == DATASET:
            folder = str(event.result.get("folder", ""))
            result = {"folder": folder, "warnings": event.result.get("warnings")}
            made = prepared(result, in_the_dialogs_words)
            state = replace(state, problem=problem, prepared=made if folder else state.prepared)
            return state, (SummariseDataset(folder),) if folder else ()
        case name if name == LOOK:
            if problem:  # it stands beside the folder's name, not above everything
                return replace(state, photos=replace(state.photos, problem=problem)), ()
            return replace(state, photos=understood(state.photos, event.result)), ()
        case name if name == PHOTOS and not problem:
            made = prepared(event.result)
            effects = (SummariseDataset(made.folder),) if made.folder else ()
            # What is known of the photos stays until the scene has others, or they would be looked at again.
            return replace(state, prepared=made), effects
    return replace(state, problem=problem), ()


# ---- the backend -------------------------------------------------------------------------------------------


def _asked(before: State, request: Request) -> Result:
    if isinstance(request, Shutdown) and before.link.status != "connected":
        return _shut_down_unheard(before)
    if before.link.barred:
        return replace(before, problem=before.link.barred), ()
    state = replace(before, problem=None, exported=None)
    if isinstance(request, TrainStart | TrainResume | RunOpen):
        run = request.out if isinstance(request, TrainStart) else request.run
        job = JobStatus(state="preparing", run=run)
        job = replace(job, in_control=state.job.in_control, controller=state.job.controller)
        state = replace(state, history=History(), job=job, beginning=request, read=None, made=None)
    if state.link.status == "connected":
        return state, (Send(request),)
    state = replace(state, waiting=(*state.waiting, request))
    return state, (StartBackend(),) if state.link.status == "off" else ()


def _shut_down_unheard(before: State) -> Result:
    """One that cannot be asked can only be ended from outside.

    One of another version is at work: it is asked first, and ended at the second time. One that does not
    answer hangs: it is ended at once.
    """
    state, pid = _without_job(replace(before, link=Link(), problem=None)), before.link.pid
    if before.link.barred and before.link.barred != ENDING:
        return replace(state, link=Link(log=before.link.log, pid=pid, barred=ENDING)), (EndBackend(pid),)
    return state, (KillBackend(pid),) if pid else ()


def _connected(state: State, welcome: Welcome) -> Result:
    effects = tuple(Send(request) for request in state.waiting)
    link = Link("connected", welcome, welcome.log or state.link.log, welcome.pid)
    job = replace(state.job, in_control=welcome.in_control)
    # A training that runs already has a past, which only the backend knows.
    return replace(state, link=link, job=job, waiting=()), (Send(HistoryGet()), *effects)


def _link_lost(state: State, reason: str, clean: bool) -> State:
    log, job = state.link.log, state.job
    gone = f"The backend is gone: {reason}"
    problem = None if clean else Problem(gone, f"The log is {log}" if log else "", log)
    if state.active and clean and _has_begun(state):
        job = replace(job, has_model=False, state="stopped", message="saved, and stopped")
    elif state.active:
        failure = Failure(code="backend_gone", message=gone, hint=_rescue(state))
        job = replace(job, state="failed", failure=failure, has_model=False)
    elif job.state != "failed":
        # What it held is gone with it; a failure is shown until it has been read.
        state = _without_job(state)
        job = state.job
    link = Link("off", log=log, pid=0 if clean else state.link.pid, problem=problem)
    return replace(state, link=link, job=job, waiting=(), beginning=None, stopping=False)


def _not_taken(state: State, refusal: Failure) -> State:
    """The backend lives, and takes no connection from this Blender: what it does is not known."""
    log, pid = state.link.log, state.link.pid
    message = f"A backend of another version is running: {refusal.message}"
    saves = "Or shut it down: a training saves a checkpoint first; on Windows its last one stays."
    problem = Problem(message, f"{refusal.hint} {saves}".strip(), log)
    link = Link("off", log=log, pid=pid, problem=problem, barred=problem)
    state = _without_job(state) if state.active else state
    return replace(state, link=link, waiting=(), beginning=None, stopping=False)


def _has_begun(state: State) -> bool:
    """Whether a training was under way. While one is asked for, what is known is of the former one."""
    return state.beginning is None and state.job.has_model and state.job.state != "preparing"


def _rescue(state: State) -> str:
    """What is left of a training whose backend is gone."""
    if state.job.saved_iteration:
        return f"Resume continues from the checkpoint of iteration {state.job.saved_iteration}."
    if _has_begun(state):
        return "Nothing that it had learned was saved yet: start again."
    return "Nothing that the run had saved is lost: start it, resume it or open it again."


def _backend_failed(state: State, status: JobStatus) -> State:
    """The backend itself has failed, whatever it did: a run that it worked at has failed, too."""
    job = replace(status, run=state.job.run, saved_iteration=state.job.saved_iteration)
    return replace(state, job=job, waiting=(), beginning=None, stopping=False)


def _without_job(state: State) -> State:
    """There is no backend, and what it held is not there any more: neither a model nor its curves."""
    return replace(state, job=JobStatus(), history=History(), exported=None)


def _received(state: State, message: Reply, request: Request | None) -> Result:
    if isinstance(message, JobStatus) and message.failure:
        message = replace(message, failure=job_words.for_panel(message.failure))
    match message:
        case JobStatus(state="failed", run=""):
            return _backend_failed(state, message), ()
        case JobStatus() if state.beginning:
            return _before_the_answer(state, message), ()
        case JobStatus():
            return _job_changed(state, message), ()
        case Done() if state.beginning and request == state.beginning:
            news = (Send(StatusGet()),)
            if not isinstance(request, TrainStart):  # it has a past, which only the backend knows
                news = (*news, Send(HistoryGet()))
            return replace(state, beginning=None), news
        case History():
            return replace(state, history=message), ()
        case Exported():
            return replace(state, exported=message), ()
    return state, ()


def _before_the_answer(state: State, status: JobStatus) -> State:
    """The status of the former job says nothing about the requested one, except who is in control.

    How far its preparation is counts, and how far the backend itself is that has to start for it.
    """
    job = replace(state.job, in_control=status.in_control, controller=status.controller)
    if status.state == "preparing" and (not status.run or same_folder(status.run, job.run)):
        job = replace(job, message=status.message)
    return replace(state, job=job)


def _job_changed(state: State, job: JobStatus) -> State:
    history = state.history
    if job.run != state.job.run or job.iteration < state.job.iteration:
        history = History()  # another training, or an earlier state of this one
    if job.losses and job.iteration > _last(history.iterations):
        history = replace(
            history,
            iterations=(*history.iterations, job.iteration),
            losses=(*history.losses, sum(job.losses.values())),
        )
    # The status keeps the last measurement until there is a newer one.
    if "PSNR" in job.monitor and (job.monitor != state.job.monitor or not history.psnr):
        history = replace(
            history,
            psnr_iterations=(*history.psnr_iterations, job.iteration),
            psnr=(*history.psnr, job.monitor["PSNR"]),
        )
    has_moved = (job.state, job.iteration, job.message) != (
        *(state.job.state, state.job.iteration, state.job.message),
    )
    state = replace(state, job=job, history=history, pace=Pace() if has_moved else state.pace)
    return state if state.active else replace(state, stopping=False)


def _last(iterations: tuple[int, ...]) -> int:
    return iterations[-1] if iterations else 0
