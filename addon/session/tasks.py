# SPDX-License-Identifier: GPL-3.0-or-later
"""What child processes do for us, as the panel calls it: every task that can be started, and so cancelled;
what is said while one shows no progress, and when it has made something. Pure."""

import os

from .light import LIGHT
from .results import BAKE, EVALUATE, VIDEO, WEB
from .state import CHECK, DATASET, INSTALL, LOOK, PHOTOS, Made, Running, State

#: The task's name, what the panel calls it, what it is.
TASKS = (
    (INSTALL, "Installation", "The installation of the backend"),
    (CHECK, "Check", "The check of the backend"),
    (DATASET, "Data Set", "The rendering of a data set"),
    (LOOK, "Look", "The look at a folder of photos"),
    (PHOTOS, "Photos", "The preparation of photos"),
    (EVALUATE, "Evaluation", "The evaluation of a run"),
    (VIDEO, "Video", "The making of a video"),
    (WEB, "Web Page", "The writing of a web page"),
    (LIGHT, "Light", "The drawing of a model's light"),
    (BAKE, "Bake", "The fit of a model's colours for other viewers"),
)
TITLES = {name: title for name, title, _ in TASKS}
#: What was done, once it is. What a check or a look at photos finds is seen where it was asked for.
ENDED = {
    INSTALL: "The trainer is installed",
    DATASET: "Data set rendered",
    PHOTOS: "Data set made",
    EVALUATE: "Evaluated",
    VIDEO: "Video made",
    WEB: "Web page written",
    LIGHT: "Light taken",
    BAKE: "Baked",
}
#: Of these another program shows what was made.
SHOWN = (EVALUATE, VIDEO, WEB)


def ended(made: Made) -> str:
    """What was made, in a line."""
    return f"{ENDED[made.task]}: {os.path.basename(os.path.normpath(made.path))}"


def can_be_shown(made: Made) -> bool:
    """Whether it is a file that another program opens: a page, a video, a picture."""
    return made.task in SHOWN and os.path.isfile(made.path)


def folder_of(made: Made) -> str:
    """The folder that shows what was made."""
    return made.path if os.path.isdir(made.path) else os.path.dirname(made.path)


def stage(task: Running) -> str:
    """What a task does now; for how long, where it has shown no progress for a while."""
    return _with_time(task.message or TITLES[task.name], task.pace.quiet)


def stage_of_training(state: State) -> str:
    """The same of the training; empty where it shows by its numbers what it does."""
    words = {"preparing": "Preparing", "stopping": "Saving"}.get(state.job.state, "")
    words = state.job.message or words or (f"Iteration {state.job.iteration}" if state.pace.quiet else "")
    return _with_time(words, state.pace.quiet)


def _with_time(words: str, quiet: int) -> str:
    return f"{words}: {duration(quiet)} so far" if quiet else words


def duration(seconds: float) -> str:
    """``75`` → ``1 min 15 s``."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {seconds} s" if minutes else f"{seconds} s"
