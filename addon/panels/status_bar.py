# SPDX-License-Identifier: GPL-3.0-or-later
"""What is under way, in Blender's status bar: it is seen whatever the sidebar shows."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import bpy

from ..blender import add_entry, layout_of, remove_entry
from ..runtime import session
from ..session.state import State
from ..session.tasks import TASKS
from .parts import duration

#: Of a bar, in units of the interface.
WIDTH = 12.0
_TITLES = {name: title for name, title, _ in TASKS}


class Work(NamedTuple):
    """``task``: the child process that a button cancels; empty: a training, which its own panel stops."""

    text: str
    fraction: float
    task: str = ""


def at_work(state: State) -> Iterator[Work]:
    """The training and each child process, with the time that is left where it is known."""
    job = state.job
    if state.active:
        text = f"Training {job.iteration} / {job.iterations}" if job.iterations else "Preparing a training"
        yield Work(_with_time(text, job.seconds_left), job.iteration / max(job.iterations, 1))
    for task in state.tasks:
        text = "Cancelling" if task.cancelling else f"{task.fraction:.0%}"
        text = _with_time(f"{_TITLES.get(task.name, task.name)} {text}", task.seconds_left)
        yield Work(text, task.fraction, task.name)


def _with_time(text: str, seconds: float) -> str:
    return f"{text}, {duration(seconds)} left" if seconds > 0.0 else text


def draw(header: Any, context: bpy.types.Context) -> None:
    """Appended to the status bar's header."""
    layout = layout_of(header)
    for work in at_work(session().state):
        row = layout.row(align=True)
        bar = row.row()
        bar.ui_units_x = WIDTH
        bar.progress(factor=work.fraction, text=work.text)
        if work.task:
            row.operator("physhdr.task_cancel", text="", icon="X").name = work.task


def register() -> None:
    add_entry(bpy.types.STATUSBAR_HT_header, draw)


def unregister() -> None:
    remove_entry(bpy.types.STATUSBAR_HT_header, draw)
