# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says of the state: how things are, what to do next, why a button is greyed. Pure."""

import os
from dataclasses import dataclass

from ...bridge.messages import JobStatus
from ...bridge.run_folder import same_folder
from .state import CHECK, DATASET, ENDING, INSTALL, LOOK, PHOTOS, Link, Problem, State
from .tasks import TASKS

#: What the state of a job is called, for people.
JOB_WORDS = {
    "idle": "No training",
    "preparing": "Preparing",
    "training": "Training",
    "paused": "Paused",
    "stopping": "Saving and stopping",
    "stopped": "Stopped: can be resumed",
    "finished": "Finished",
    "failed": "Failed",
    "open": "Trained model open",
}


#: What is done with a result in the scene, in that order: what it is called, what the panel says, and whether
#: it can be done without a backend.
IMPORTED, SEEN, SET_UP, LIT, SHARED = "imported", "seen", "set up", "lit", "shared"
IN_SCENE = (
    (IMPORTED, "Import the result into the scene", True),
    (SEEN, "Look through the capture's cameras: ◀ ▶ below the sliders", True),
    (SET_UP, "Set up the render, in the panel Render", True),
    (LIT, "Let it light your own objects: Light From Here", False),
    (SHARED, "Export a web page of it, or make a video", False),
)
#: What the user does first with a file that names places outside it.
LOOK_FIRST = "Look at what this file names outside it, if you trust it"


@dataclass(frozen=True)
class Choices:
    """What the user has chosen in Blender, as far as it decides what can be done.

    ``of_file``: these are the open file's own choices, not what a script may give. ``out``: the run's folder,
    the one that is proposed where none is chosen. ``unsaved``: a folder that is relative to a .blend which is
    not saved, and so nowhere. ``not_looked_at``: what the file names and the user has not chosen since it was
    opened; nothing else here names it. ``done``: of ``IN_SCENE``, with a model that is in the scene: the
    run's, where the folder holds one.
    """

    data: str = ""
    out: str = ""
    out_has_run: bool = False
    online: bool = True
    preview: bool = False
    photos: str = ""
    photos_out: str = ""
    of_file: bool = False
    unsaved: str = ""
    not_looked_at: tuple[str, ...] = ()
    done: frozenset[str] = frozenset()


def headline(state: State, choices: Choices | None = None) -> str:
    """How things are, in one line."""
    for name, words in ((INSTALL, "Installing the backend"), (CHECK, "Checking the backend")):
        if state.task(name):
            return words
    for name, words in (
        (DATASET, "Rendering the data set"),
        (LOOK, "Looking at the photos"),
        (PHOTOS, "Preparing the photos"),
    ):
        if state.task(name) and not state.active:
            return words
    if not state.backend.ready:
        return "The backend failed its check" if state.backend.problem else "No trainer yet"
    if state.link.barred:
        return ENDING.message if state.link.barred == ENDING else "Another version's backend is running"
    if state.link.problem:
        return "The backend is gone"
    if state.link.status in ("starting", "connecting"):
        return "The backend starts"
    job, mine = state.job, is_of_file(state.job, choices or Choices())
    if job.state == "idle" or not (mine or state.active):
        return "Ready"
    words = "Saving and stopping" if state.stopping else JOB_WORDS[job.state]
    return words if mine else f"{words}: {os.path.basename(os.path.normpath(job.run))}"


def next_step(state: State, choices: Choices) -> str:
    """What the user would do next, in one line; empty where there is nothing but to wait."""
    if state.task(INSTALL) or state.task(CHECK):
        return ""
    if not state.backend.ready:
        if IMPORTED in choices.done and (step := _in_scene(choices, with_backend=False)):
            return step
        if state.backend.incomplete:
            return "Add what is missing, or use another Python"
        if state.backend.problem:
            return "See its log, then install it again or use another Python"
        return "Get the trainer, or open a splat"
    if state.task(DATASET) or state.task(LOOK) or state.task(PHOTOS):
        return ""
    job = state.job
    mine = is_of_file(job, choices)
    if state.link.barred:
        return state.link.barred.hint
    if state.link.problem and job.failure and mine and job.saved_iteration:
        return "Resume the training"
    if not state.active and choices.photos and state.photos.folder:
        return "Choose another folder of photos" if state.photos.problem else "Prepare the photos"
    match job.state:
        case "preparing" | "stopping":
            return ""
        case "training" | "paused" if not mine:
            return "Wait for the training of another run, or stop it"
        case "training":
            return "" if choices.preview else "Turn on Live Preview to watch it"
        case "paused":
            return "Continue, or stop"
        case "failed" if mine:
            return job.failure.hint if job.failure and job.failure.hint else "See the log"
        case "stopped" if mine and job.run and IMPORTED not in choices.done:
            other = "open the run" if state.link.status == "off" else "import what it has learned so far"
            return f"Resume the training, or {other}"
        case "finished" | "stopped" | "open" if mine and _is_of(job.data, choices.data):
            return _in_scene(choices)
    if choices.unsaved:
        return unsaved(choices)
    if not choices.data and choices.not_looked_at:
        return LOOK_FIRST
    if not choices.data and IMPORTED in choices.done and (step := _in_scene(choices)):
        return step
    if not choices.data or not state.dataset.folder or state.dataset.problem:
        return "Prepare photos, render a data set from this scene, or choose one"
    if choices.out_has_run:
        return _in_scene(choices) if IMPORTED in choices.done else "Open the run, or resume its training"
    return "Start the training"


def _in_scene(choices: Choices, *, with_backend: bool = True) -> str:
    """What to do with a result next; empty where all is done."""
    wanted = (
        words for name, words, alone in IN_SCENE if name not in choices.done and (alone or with_backend)
    )
    return next(wanted, "")


def silence(link: Link) -> str:
    """What to say, after its number, of a process that lives and has no connection."""
    if link.barred is None:
        return "does not answer"
    return "is ending" if link.barred == ENDING else "is of another version"


def unsaved(choices: Choices) -> str:
    """What to say of a folder that is relative to a file which is nowhere yet."""
    return f"Save the .blend first: {choices.unsaved} is beside it"


def is_of_file(job: JobStatus, choices: Choices) -> bool:
    """Whether the backend's job is of the run that the open file has chosen; so is none at all."""
    if not choices.of_file or not job.run:
        return True
    return bool(choices.out) and same_folder(job.run, choices.out)


def holds_another(state: State, choices: Choices) -> bool:
    """Whether the backend's model is of another run than the open file's."""
    return state.job.has_model and not is_of_file(state.job, choices)


def _is_of(data: str, chosen: str) -> bool:
    """Whether a job's data set is the one that is chosen, as far as both are known."""
    return not data or not chosen or same_folder(data, chosen)


def problem_of(state: State) -> Problem | None:
    """What went wrong last, if anything did."""
    if state.problem:
        return state.problem
    if state.backend.problem:
        return state.backend.problem
    if state.job.state == "failed" and state.job.failure and state.job.failure != state.read:
        failure = state.job.failure
        return Problem(failure.message, failure.hint, state.link.log)
    return state.link.problem


def why_not(state: State, action: str, choices: Choices | None = None) -> str:
    """Why ``action`` cannot be done now, in words for a tooltip; empty where it can."""
    choices = choices or Choices()
    busy = next((task.name for task in state.tasks if task.name in (INSTALL, CHECK)), "")
    match action:
        case "install":
            if busy:
                return f"Wait for the {busy} to end, or cancel it"
            if not choices.online:
                return "Blender may not go online: Preferences, System, Network, Allow Online Access"
            return _why_not_replace(state)
        case "extend":
            if not state.backend.python:
                return "Install the backend first"
            return why_not(state, "install", choices)
        case "check" | "use_python":
            if busy:
                return f"Wait for the {busy} to end, or cancel it"
            if action == "check" and not state.backend.python:
                return "Install the backend or choose a Python first"
            return "Stop the training first" if state.active else ""
        case "start" | "resume":
            return _why_not_train(state, action, choices, busy)
        case "pause":
            can_halt = state.active and state.job.state in ("preparing", "training")
            return _why_not_steer(state) or ("" if can_halt else "Nothing is training")
        case "continue":
            return _why_not_steer(state) or ("" if state.job.state == "paused" else "Nothing is paused")
        case "stop":
            hindrance = "It is stopping" if state.stopping else ""
            return _why_not_steer(state) or (hindrance if state.active else "Nothing is training")
        case "end":
            return _why_not_steer(state) or ("" if state.stopping else "Stop the training first")
        case "open":
            if busy:
                return f"Wait for the {busy} to end"
            if not state.backend.ready:
                return "Install the backend first"
            if state.active:
                return "Stop the training first"
            if state.link.barred:
                return f"{state.link.barred.message}. {state.link.barred.hint}"
            if choices.unsaved:
                return unsaved(choices)
            return "" if choices.out_has_run else _or_look(choices, "Choose the folder of a trained run")
        case "import":
            mine = is_of_file(state.job, choices)
            if state.link.status == "connected" and state.job.has_model and mine:
                return _why_not_steer(state)  # the backend writes the file for the one who steers
            no_run = "Train a model, or choose the folder of a run, first"
            return "" if choices.out_has_run else _or_look(choices, no_run)
        case "preview":
            if holds_another(state, choices):
                shown = os.path.basename(os.path.normpath(state.job.run))
                return f"The trainer has the model of another run open, {shown}: open this file's instead"
            return "" if state.job.has_model else "There is no model yet: start a training or open a run"
        case "shutdown":  # of one that is ending already: at once
            return "" if state.link.status == "off" and state.link.pid else _why_not_steer(state)
        case "take_control":
            if state.link.status != "connected":
                return "No backend is running"
            return "This Blender is in control already" if state.job.in_control else ""
        case "render":
            return "A data set is being rendered" if state.task(DATASET) else ""
        case "look":
            return _why_not_photos(state, busy)
        case "photos":
            return _why_not_photos(state, busy) or _why_not_prepare(state, choices)
    raise ValueError(f"there is no action {action!r}")


def _why_not_replace(state: State) -> str:
    """Why the backend's environment cannot give way to another one: because something works by it.

    A backend that is idle is no hindrance, where it is ours to shut down (``transition``).
    """
    # All but Blender's own work.
    at_work = next((words for name, words, _ in TASKS if name != DATASET and state.task(name)), "")
    if at_work:
        return f"The backend is at work ({at_work}): wait for that to end, or cancel it"
    if state.active:
        return "Stop the training first"
    if state.link.status == "connected":
        return _why_not_steer(state)
    if state.link.status != "off":
        return "The backend starts: wait until it has"
    return "The backend does not answer: end it first" if state.link.pid else ""


def _why_not_steer(state: State) -> str:
    if state.link.status != "connected":
        return "No backend is running"
    if not state.job.in_control:
        who = state.job.controller or "another Blender"
        return f"{who} is in control: take control first"
    return ""


def _why_not_photos(state: State, busy: str) -> str:
    if busy:
        return f"Wait for the {busy} to end"
    if not state.backend.ready:
        return "Install the backend, or use an existing Python, first: it prepares photos"
    if state.task(LOOK):
        return "The photos are being looked at"
    return "Photos are being prepared" if state.task(PHOTOS) else ""


def _or_look(choices: Choices, words: str) -> str:
    """What to say of something missing that the file may name."""
    return LOOK_FIRST if choices.not_looked_at else words


def _why_not_prepare(state: State, choices: Choices) -> str:
    if state.backend.missing:
        return f"The backend lacks {', '.join(state.backend.missing)}: add what is missing"
    if not choices.photos:
        return "Choose the folder of your photos"
    if state.photos.folder == choices.photos and state.photos.problem:
        return state.photos.problem.message
    return "" if choices.photos_out else "Choose a folder for the data set"


def _why_not_train(state: State, action: str, choices: Choices, busy: str) -> str:
    if busy:
        return f"Wait for the {busy} to end"
    if not state.backend.ready:
        return "Install the backend, or use an existing Python, first"
    if state.active:
        return "A training is under way"
    if state.link.barred:
        return f"{state.link.barred.message}. {state.link.barred.hint}"
    if state.link.status == "connected" and not state.job.in_control:
        return _why_not_steer(state)
    if choices.unsaved:
        return unsaved(choices)
    if action == "resume":
        no_run = "There is no training to resume in the run's folder"
        return "" if choices.out_has_run else _or_look(choices, no_run)
    if not choices.data:
        return _or_look(choices, "Choose a data set")
    if state.dataset.folder == choices.data and state.dataset.problem:
        return state.dataset.problem.message
    return ""
